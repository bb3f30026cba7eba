"""In place of blackbox-tools' `blackbox_decode --stdout --index N FILE`: the decoder orangebox."""

import sys

from orangebox import Parser

parser = Parser.load(sys.argv[4], int(sys.argv[3]))
rows = [", ".join(map(str, frame.data)) for frame in parser.frames()]
print(", ".join("time (us)" if name == "time" else name for name in parser.field_names))
print("\n".join(rows))
