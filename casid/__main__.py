"""`python -m casid` is `casid`."""

from __future__ import annotations

from casid.cli.main import main

if __name__ == "__main__":
    main()
