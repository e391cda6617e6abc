"""The line between what its user can put right and what is wrong with the program."""

from __future__ import annotations


class InputError(ValueError):
    """Something that the user gave cannot be used: a flag, a file, a scene. The message says what would be right.

    Raised where input comes in. Any other error that ends a command is a fault of the program and reported as one.
    """
