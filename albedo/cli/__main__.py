"""``python -m albedo.cli``."""

from albedo.cli import main

main()
