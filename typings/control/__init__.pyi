# python-control annotates its arguments too narrowly to be checked against.
from typing import Any

def __getattr__(name: str) -> Any: ...
