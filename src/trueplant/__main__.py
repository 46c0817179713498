"""``python -m trueplant`` is the command ``trueplant``."""

from trueplant.cli import main

if __name__ == "__main__":
    raise SystemExit(main())
