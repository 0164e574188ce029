"""What is found in data, with what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from casid.deprecation import renamed

Severity = Literal["error", "warning", "note"]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing found: an error keeps the data from being used, a warning may spoil a result."""

    severity: Severity
    channel: str | None
    text: str
    remedy: str
    about: Literal["rest", "limit", ""] = ""  # that a channel is constant, or stands at a limit
    mend = renamed("mend", "remedy")

    def __str__(self) -> str:
        where = f"{self.channel}: " if self.channel else ""
        return f"{self.severity:<8} {where}{self.text} {self.remedy}".rstrip()

    def to_json(self) -> dict[str, str | None]:
        """Return the finding as a dict of plain values."""
        return {
            "severity": self.severity,
            "channel": self.channel,
            "text": self.text,
            "mend": self.remedy,
        }
