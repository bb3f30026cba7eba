"""`python -m quadsim.cli` is `quadsim`."""

from . import main

main()
