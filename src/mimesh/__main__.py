"""`python -m mimesh`: the same as `mimesh`."""

from .cli import main

main()
