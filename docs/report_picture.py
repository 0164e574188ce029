"""Draw docs/report.png, the report that the README shows, with a headless Chromium.

python docs/report_picture.py [CHROMIUM]
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SIZE = "1000,1000"


def main(arguments: list[str]) -> int:
    """Diagnose the roll decay and picture the top of its page; 1 without a browser."""
    browser = arguments[0] if arguments else shutil.which("chromium") or shutil.which("chrome")
    if browser is None:
        print("no Chromium found; name one: python docs/report_picture.py PATH", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        problem = str(ROOT / "problems" / "roll_decay.py")
        diagnose = [sys.executable, "-m", "casid", "diagnose", problem, "--quiet"]
        subprocess.run([*diagnose, "--out", f"{folder}/report"], cwd=ROOT, check=True)
        picture = [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"]
        picture += [f"--window-size={SIZE}", "--virtual-time-budget=8000"]
        picture += [f"--screenshot={ROOT / 'docs' / 'report.png'}"]
        page = Path(folder, "report", "report.html").as_uri()
        subprocess.run([*picture, page], check=True, capture_output=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
