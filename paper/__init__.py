"""The paper again: every table and figure from nothing, ours beside theirs, and what its claims are worth."""

from .run import paper

__all__ = ["paper"]
