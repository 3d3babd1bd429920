"""`python -m app.cli`: the `tada` command."""

from app.cli.main import main

main()
