"""`python -m casid` is `casid`."""

from __future__ import annotations

from casid.cli import main

if __name__ == "__main__":
    main()
