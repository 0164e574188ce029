"""Write the golden files again: `python -m tests.report.write_golden`, then read the difference.

Run it when a text or page was changed on purpose; `git diff tests/report/golden` is the review.
"""

from __future__ import annotations

from tests.report.golden_results import FOLDER, golden_texts


def main() -> None:
    """Replace all golden files."""
    FOLDER.mkdir(exist_ok=True)
    made = {name: make() for name, make in golden_texts()}  # all or none
    for path in FOLDER.iterdir():
        path.unlink()
    for name, text in made.items():
        (FOLDER / name).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
