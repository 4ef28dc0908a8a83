"""What the workbench says when it cannot do what was asked."""


class InputError(ValueError):
    """Bad input: one sentence that names what was given and what is allowed."""


class DivergenceError(InputError):
    """The value asked for is infinite, such as a Ward albedo at cos_theta = 0."""


class ConvergenceWarning(UserWarning):
    """A tolerance was not met within the budget; the bound in the result still holds."""


class CacheWarning(UserWarning):
    """What is kept on disk cannot be read or written; it is computed anew, and nothing is lost."""
