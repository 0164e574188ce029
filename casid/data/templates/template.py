"""What a template is: the signals it knows, and the lines it writes for a file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from casid.data.templates.draft import Draft
from casid.data.templates.file_channels import FileChannels
from casid.data.templates.roles import Role


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """The model of a problem file, as lines of Python; empty lines are left out.

    Attributes
    ----------
    equations : in words, for the head of the file.
    relations : derivatives and balances.
    advice : a paragraph for the head of the file.
    """

    equations: Sequence[str]
    inputs: Sequence[str]
    states: Sequence[str]
    parameters: Sequence[str]
    relations: Sequence[str]
    outputs: Sequence[str]
    advice: str = ""

    def paragraphs(self) -> list[str]:
        """Each matter below its comment."""
        heads = {
            "Inputs: recorded; between samples held (zoh) or joined by straight lines (foh)": (
                self.inputs
            ),
            "States: their initial values are estimated": self.states,
            "Parameters: estimated from `start` between the bounds; a constant is known": (
                self.parameters
            ),
            "Equations: what is missing in a balance, a diagnosis can find": self.relations,
            "Outputs: what the sensors measure": self.outputs,
        }
        kept = {head: [line for line in lines if line] for head, lines in heads.items()}
        return ["\n".join([f"# {head}", *lines]) for head, lines in kept.items() if lines]


@dataclass(frozen=True, slots=True)
class Template:
    """A kind of system.

    Attributes
    ----------
    name : as in `--as`.
    title : of the model.
    roles : the signals that it knows, from the channels of a file.
    write : the model for a draft.
    needs_casadi : True where the model calls functions of CasADi.
    """

    name: str
    title: str
    roles: Callable[[FileChannels], Sequence[Role]]
    write: Callable[[Draft], Body]
    needs_casadi: bool = False
