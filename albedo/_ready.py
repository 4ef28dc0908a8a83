"""What every study needs, loaded once by the process that they are forked from.

It runs on one thread, and reads no module that computes: what a study read is told from its own
imports. Of the half second that numba takes until it can load a kernel, this saves two thirds.
"""

from importlib import import_module

from numba.core.registry import cpu_target

for _name in (
    *("albedo.runner", "numpy", "pandas", "numba.typed", "numba.np.ufunc", "scipy.special"),
    *("scipy.linalg", "scipy.integrate", "scipy.optimize", "matplotlib.axes"),
    *("matplotlib.figure", "matplotlib.colorbar", "matplotlib.legend", "matplotlib.layout_engine"),
    *("matplotlib.backends.backend_agg", "matplotlib.backends.backend_svg"),
    "PIL.PngImagePlugin",
):
    import_module(_name)

cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
