"""`python -m spheremouse` is `spheremouse`."""

from spheremouse.cli import main

main()
