"""Make the learning curve of the tutorial on reinforcement learning: `python docs/learning_curve.py`.

It runs `examples/ppo.py --seeds 3`.
"""

import sys

from pages import ROOT, load_page

sys.path.insert(0, str(ROOT / "examples"))
import ppo


def main() -> None:
    """Train with three seeds, and stamp the picture."""
    page = load_page("learning-curve")
    out = page.root / "reports" / "ppo"
    ppo.main(["--seeds", "3", "--out", str(out)])
    path = page.root / "docs" / "img" / "ppo.png"
    path.write_bytes((out / "ppo.png").read_bytes())
    page.sign_image(path, 32)
    page.note()


if __name__ == "__main__":
    main()
