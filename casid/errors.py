"""The errors casid raises on purpose: what went wrong, where, and how to mend it."""

from __future__ import annotations


class CasidError(Exception):
    """Base of every error that casid raises on purpose."""


class DataError(CasidError, ValueError):
    """A record, file or channel cannot be used as it stands."""


class UnitError(DataError):
    """A unit is unknown, ambiguous, or of another dimension than the model's."""


class ModelError(CasidError):
    """A model or problem file contradicts itself."""


class IdentifiabilityError(CasidError):
    """The model and experiments cannot give the parameters asked for."""


class SolveError(CasidError):
    """A simulation diverged or a solver gave up."""
