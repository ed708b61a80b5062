"""`python -m spheremouse` is `spheremouse`."""

from spheremouse.commands import main

main()
