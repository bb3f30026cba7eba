"""The pages of a finished `quadsim paper --preset full --out runs/paper`: `python docs/paper_page.py`."""

import sys
from pathlib import Path

from PIL import Image

from paper.run import load_settings, write_results

HERE = Path(__file__).parent


def main() -> None:
    """Write paper.md, the three pages beside it and their figures, these with few colours."""
    parts = Path(sys.argv[1] if len(sys.argv) > 1 else "runs/paper") / "full"
    page, _ = write_results(
        parts, HERE, load_settings(parts), "paper-", "img", ("png",), "python docs/paper_page.py"
    )
    for path in (HERE / "img").glob("paper-*.png"):
        Image.open(path).convert("P", palette=Image.Palette.ADAPTIVE, colors=64).save(path, optimize=True)
    print(page)


if __name__ == "__main__":
    main()
