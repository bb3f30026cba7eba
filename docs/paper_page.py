"""The pages of a finished `quadsim paper --preset full --out runs/paper`: `python docs/paper_page.py`."""

import sys
from pathlib import Path

from pages import load_page

from paper.pages import Placement
from paper.run import write_results
from paper.settings import settings_of


def main() -> None:
    """Write paper.md, the three pages beside it and their figures, these with few colours."""
    page = load_page("paper")
    docs = page.root / "docs"
    parts = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/paper") / "full"
    placement = Placement("paper-", "img", ("png",), "python docs/paper_page.py")
    write_results(parts, docs, settings_of("full"), placement)
    for written in page.made:
        if written.suffix == ".md":
            page.sign(written)
        else:
            page.sign_image(written, 64)
    print(docs / "paper.md")


if __name__ == "__main__":
    main()
