"""Why an extension of the model is refused: in words, and by which error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why an extension of the model is refused; false where it is not.

    Attributes
    ----------
    text : a clause about the extension; empty where it is not refused.
    error : that of which part refuses it; empty where no error does.
    """

    text: str = ""
    error: Literal["fitted", "held-out", ""] = ""

    def __bool__(self) -> bool:
        return bool(self.text)

    def beside(self, others: str) -> Refusal:
        """The same of an extension of a model that has others by then; empty text: of none."""
        return replace(self, text=f"beside {others}, {self.text}") if others else self


ACCEPTED = Refusal()
SUPERFLUOUS = Refusal("the other causes together leave nothing for it to explain")
FEIGNED = Refusal("without the bias that noise on measured inputs gives, its size is zero")
RANDOM = Refusal("an unrecorded random disturbance explains the misfit as well")
LEAVES_MORE = Refusal("it seems to imitate a better law, and leaves more than noise")
