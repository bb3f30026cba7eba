"""A job for worker processes, which import it from here."""

import os


def square(number: int, deadly: int) -> int:
    """The square, of all but one number that ends the process."""
    if number == deadly:
        os._exit(1)
    return number**2
