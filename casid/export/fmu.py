"""A fitted model as a functional mock-up unit (FMI 2.0, Model Exchange and Co-Simulation).

The unit holds CasADi's generated C of the equations and of the fit's own step, within a small
implementation of the standard (`fmi2.c`), compiled for this machine, with its sources. CasADi's own
`DaeBuilder.export_fmu` (3.8, experimental) makes units of FMI 3.0 for model exchange alone, which
few tools read and which leave the step of the fit behind.
"""

from __future__ import annotations

import hashlib
import importlib.resources
import platform
import sys
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import casadi as ca

from casid.compiler import compiler, shared_library
from casid.errors import DataError
from casid.estimation.fitted.fitted_model import FittedModel
from casid.export.c_code import header, source
from casid.export.naming import checked_path, written_by
from casid.export.plain_model import PlainModel, plain_model
from casid.model.identifiers import identifier
from casid.model.units import unit_quotient

_SOURCES = ("fmi2.c", "model.c")  # compiled; beside them their headers


def write_fmu(fitted: FittedModel, path: Path, *, without_delays: bool = False) -> Path:
    """Write an FMU to `path` (.fmu) for the machine that it is written on.

    Variables are named as in the model and in SI units; parameters are tunable, initial states can
    be set. In co-simulation with the sample time as communication step, and with the derivatives of
    the inputs where those are joined by straight lines, it takes the same steps as the fit.
    Where sensors or inputs are delayed there is co-simulation alone, by whole samples.

    Raises
    ------
    ModelError
        If an input is a function of the user's own.
    DataError
        If there is no C compiler, or FMI 2.0 has no name for this machine.
    """
    plain = plain_model(fitted, what="an FMU", without_delays=without_delays)
    path = checked_path(path, "fmu")
    if compiler() is None:
        raise DataError(
            "an FMU holds a compiled library, and no C compiler is found here; install gcc or "
            "clang, or name one in the variable CC. The other exports need none"
        )
    prefix = identifier(path.stem)
    model_c, model_h = source(plain, "model", header="model.h"), header(plain, "model")
    variables = _Variables(plain)
    content = "".join((model_c, model_h, *map(str, variables.rows)))
    guid = "{" + hashlib.sha256(content.encode()).hexdigest()[:32] + "}"
    texts = {
        "model.c": model_c,
        "model.h": model_h,
        "config.h": _config(plain, fitted.records[0].t0, guid),
        "fmi2.c": importlib.resources.files("casid.export").joinpath("fmi2.c").read_text("utf-8"),
    }
    place, suffix = _platform()
    with TemporaryDirectory() as folder:
        for name, text in texts.items():
            Path(folder, name).write_text(text, encoding="utf-8")
        library = Path(folder, prefix + suffix)
        shared_library([Path(folder, name) for name in _SOURCES], library)
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("modelDescription.xml", variables.description(prefix, guid, fitted))
            archive.write(library, f"binaries/{place}/{library.name}")
            for name, text in texts.items():
                archive.writestr(f"sources/{name}", text)
    return path


def _platform() -> tuple[str, str]:
    """The name that FMI 2.0 has for this machine, and the suffix of its libraries."""
    names = {"linux": ("linux64", ".so"), "darwin": ("darwin64", ".dylib")}
    names |= {"win32": ("win64", ".dll")}
    if sys.platform not in names or sys.maxsize < 2**32:
        raise DataError(
            f"FMI 2.0 has no name for the platform {sys.platform} ({platform.machine()}); export C "
            "and build the unit there"
        )
    return names[sys.platform]


def _config(plain: PlainModel, t0: float, guid: str) -> str:
    shares = ", ".join(repr(share) for share in plain.shares()) or "0.0"
    return "\n".join(
        [
            f"#define NX {len(plain.states)}",
            f"#define NU {len(plain.inputs)}",
            f"#define NY {len(plain.outputs)}",
            f"#define NP {len(plain.parameters)}",
            f"#define NPAST {plain.memory_size}",
            f"#define SAMPLE_TIME {plain.Ts!r} /* s */",
            f"#define SUBSTEPS {plain.substeps}",
            f"#define T_START {t0!r} /* s */",
            f'#define GUID "{guid}"',
            "/* The part of its rise within a sample that each input makes as a straight line. */",
            f"#define SHARES {{{shares}}}",
            "",
        ]
    )


@dataclass(frozen=True, slots=True)
class _Row:
    """One variable of the description."""

    reference: int
    name: str
    unit: str
    causality: str
    variability: str
    initial: str = ""
    start: float | None = None
    derivative: int | None = None  # place of its state, counted from 1
    says: str = ""


class _Variables:
    """The variables of a unit, in the order of their value references."""

    def __init__(self, plain: PlainModel) -> None:
        self.plain = plain
        nx = len(plain.states)
        self._seen = self._states_seen()
        rows = [
            _Row(
                i,
                self._state_name(s),
                plain.unit(s) if s not in plain.outputs else plain.model.states[s].unit,
                "output" if s in self._seen else "local",
                "continuous",
                "exact",
                float(plain.initial[s]),
            )
            for i, s in enumerate(plain.states)
        ]
        rows += [
            _Row(
                nx + i,
                f"der({self._state_name(s)})",
                unit_quotient(plain.model.states[s].unit, "s"),
                "local",
                "continuous",
                derivative=i + 1,
            )
            for i, s in enumerate(plain.states)
        ]
        n = 2 * nx
        for i, (name, share) in enumerate(zip(plain.inputs, plain.shares(), strict=True)):
            says = "held between its samples" if share == 0 else ""
            kind = "discrete" if share == 0 else "continuous"
            rows.append(_Row(n + i, name, plain.unit(name), "input", kind, "", 0.0, None, says))
        n += len(plain.inputs)
        for i, name in enumerate(plain.outputs):
            if name not in self._seen:
                rows.append(_Row(n + i, name, plain.unit(name), "output", "continuous"))
        n += len(plain.outputs)
        for i, name in enumerate(plain.parameters):
            value = float(plain.values[name])
            unit = plain.model.parameters[name].unit
            rows.append(_Row(n + i, name, unit, "parameter", "tunable", "exact", value))
        self.rows = rows

    def _states_seen(self) -> set[str]:
        """States that an output of the same name shows as they are."""
        model = self.plain.model
        return {
            s
            for s in model.states
            if s in model.outputs
            and s not in self.plain.delays
            and ca.is_equal(model.outputs[s][0], model.symbol(s), 1)
        }

    def _state_name(self, name: str) -> str:
        clashes = name in self.plain.outputs and name not in self._seen
        return f"state.{name}" if clashes else name

    def description(self, prefix: str, guid: str, fitted: FittedModel) -> str:
        """The content of modelDescription.xml."""
        plain = self.plain
        root = ElementTree.Element(
            "fmiModelDescription",
            fmiVersion="2.0",
            modelName=plain.name,
            guid=guid,
            description=" ".join(("A fitted model, all quantities in SI units.", *plain.notes)),
            generationTool=written_by(),
            variableNamingConvention="structured",
            numberOfEventIndicators="0",
        )
        self._write_kinds(root, prefix)
        units = ElementTree.SubElement(root, "UnitDefinitions")
        for unit in dict.fromkeys(row.unit for row in self.rows):
            ElementTree.SubElement(units, "Unit", name=unit)
        record = fitted.records[0]
        ElementTree.SubElement(
            root,
            "DefaultExperiment",
            startTime=repr(record.t0),
            stopTime=repr(record.t0 + (record.N - 1) * plain.Ts),
            stepSize=repr(plain.Ts),
        )
        variables = ElementTree.SubElement(root, "ModelVariables")
        for row in self.rows:
            _write_variable(variables, row)
        self._write_structure(root)
        ElementTree.indent(root)
        return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(
            root, encoding="unicode"
        )

    def _write_kinds(self, root: ElementTree.Element, prefix: str) -> None:
        """What the unit can be used for: delays have no time between samples."""
        is_sampled = bool(self.plain.memory_size)
        can = {"modelIdentifier": prefix, "canGetAndSetFMUstate": "true"}
        can |= {"canSerializeFMUstate": "true", "canNotUseMemoryManagementFunctions": "true"}
        steps = {
            "canHandleVariableCommunicationStepSize": "false" if is_sampled else "true",
            "canInterpolateInputs": "true",
        }
        exchange = () if is_sampled else (("ModelExchange", can),)
        for kind, more in (*exchange, ("CoSimulation", {**can, **steps})):
            files = ElementTree.SubElement(ElementTree.SubElement(root, kind, more), "SourceFiles")
            for name in _SOURCES:
                ElementTree.SubElement(files, "File", name=name)

    def _write_structure(self, root: ElementTree.Element) -> None:
        structure = ElementTree.SubElement(root, "ModelStructure")
        outputs = [i for i, row in enumerate(self.rows, 1) if row.causality == "output"]
        derivatives = [i for i, row in enumerate(self.rows, 1) if row.derivative is not None]
        computed = [i for i in outputs if self.rows[i - 1].start is None]
        for tag, places in (
            ("Outputs", outputs),
            ("Derivatives", derivatives),
            ("InitialUnknowns", sorted({*computed, *derivatives})),
        ):
            if places:
                part = ElementTree.SubElement(structure, tag)
                _write_unknowns(part, places)


def _write_unknowns(part: ElementTree.Element, places: Iterable[int]) -> None:
    for place in places:
        ElementTree.SubElement(part, "Unknown", index=str(place))


def _write_variable(variables: ElementTree.Element, row: _Row) -> None:
    given = {
        "name": row.name,
        "valueReference": str(row.reference),
        "causality": row.causality,
        "variability": row.variability,
    }
    if row.initial:
        given["initial"] = row.initial
    if row.says:
        given["description"] = row.says
    value = {"unit": row.unit}
    if row.start is not None:
        value["start"] = repr(row.start)
    if row.derivative is not None:
        value["derivative"] = str(row.derivative)
    ElementTree.SubElement(
        ElementTree.SubElement(variables, "ScalarVariable", given), "Real", value
    )
