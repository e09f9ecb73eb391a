"""What a user can get wrong, each told in one line: what, where, what was expected."""


class TutorialError(ValueError):
    """Base of every error that a user's input can cause. Its text is one line."""


class MotionFileError(TutorialError):
    """A motion file that cannot be read: ``file:line: what is wrong, what was expected``."""

    def __init__(self, path, message: str, line: int | None = None):
        self.path, self.line = str(path), line
        super().__init__(f"{path}{f':{line}' if line else ''}: {message}")

    def __reduce__(self):  # the default would call __init__ with the finished text alone
        return _rebuild, (type(self), self.args[0], self.path, self.line)


def _rebuild(kind, text, path, line):
    error = kind.__new__(kind, text)
    error.path, error.line = path, line
    return error


class MotionError(TutorialError):
    """Motions, skeletons or features that do not fit together or are not finite."""


class DataError(TutorialError):
    """A data set that is unknown, not at hand, damaged or too short."""


class CheckpointError(TutorialError):
    """A checkpoint that cannot be opened or does not fit what it is used for."""
