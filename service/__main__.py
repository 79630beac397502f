"""``python -m service`` is ``skypose``."""

from service.cli import main

if __name__ == "__main__":
    main()
