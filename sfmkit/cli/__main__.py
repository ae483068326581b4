"""Entry point of ``python -m sfmkit.cli``."""

from . import main

main()
