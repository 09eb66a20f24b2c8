"""What can go wrong; the names are those of qrsim itself."""


class QrsimError(Exception):
    """Base of every error that this package raises on purpose."""


class UsageError(QrsimError, ValueError):
    """The input was wrong: a value or a shape."""


class RunError(QrsimError):
    """What was well described could not be carried out."""
