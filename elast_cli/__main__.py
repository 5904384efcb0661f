"""`python -m elast_cli` is `elast`."""

from elast_cli.cli.app import main

if __name__ == "__main__":
    main()
