"""What is compared: a model with its parameters, and how much it may do in a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from tissue_sim.compare.effort import Effort, shortest
from tissue_sim.compare.organ import Organ
from tissue_sim.compare.spring_constants import SpringConstants
from tissue_sim.elastic import registry
from tissue_sim.elastic.model import Material, Model

MATERIAL = "material."
"""Prefix of the values that go to the material, such as material.young_modulus."""
SPRINGS = "springs."
"""Prefix of the values that go to `SpringConstants`, such as springs.stiffness."""


@dataclass(frozen=True)
class Subject:
    """A model with parameters.

    Attributes:
        model: Name of the model.
        values: What differs from the defaults: parameters of the model by name, numbers of the
            material as material.<name>, constants of its springs as springs.<name>.
        effort: How much it may do in a frame.
        label: Name for people; empty: the model's.
    """

    model: str
    values: Mapping[str, float] = field(default_factory=dict)
    effort: Effort = field(default_factory=Effort)
    label: str = ""

    @property
    def name(self) -> str:
        """Name for people."""
        return self.label or self.model

    @property
    def text(self) -> str:
        """The subject as `parse_subject` reads it, its numbers to the last bit."""
        label = f"{self.label}=" if self.label else ""
        values = ",".join(f"{name}={shortest(value)}" for name, value in self.values.items())
        return f"{label}{self.model}{':' if values else ''}{values}@{self.effort.text}"

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters of the model itself."""
        return {
            name: value
            for name, value in self.values.items()
            if not name.startswith((MATERIAL, SPRINGS))
        }

    def with_values(self, values: Mapping[str, float]) -> Subject:
        """The same with some values put in place of what it had."""
        return replace(self, values={**self.values, **values})

    def material(self, organ: Organ) -> Material:
        """What it takes the organ to be made of."""
        return self._made_of(organ.material)

    def constants(self) -> SpringConstants | None:
        """The constants of its springs; None: they follow from the material."""
        given = _under(SPRINGS, self.values)
        return SpringConstants(**given) if given else None

    def checked(self) -> Subject:
        """This subject, if its names exist and its values are in range.

        Raises:
            ValueError: There is no such model or value, or a value is out of range.
        """
        registry.checked_parameters(self.model, self._known(self.parameters))
        for prefix, known in ((MATERIAL, material_names()), (SPRINGS, SpringConstants.names())):
            unknown = sorted(set(_under(prefix, self.values)) - set(known))
            if unknown:
                raise ValueError(
                    f"there is no {prefix}{unknown[0]}; allowed: "
                    + ", ".join(prefix + name for name in known)
                )
        constants = self.constants()
        if constants is not None:
            constants.checked()
        registry.check_material(self._made_of(Material()))
        return self

    def _made_of(self, tissue: Material) -> Material:
        given: dict[str, Any] = dict(_under(MATERIAL, self.values))
        return replace(tissue, **given)

    def _known(self, parameters: dict[str, float]) -> dict[str, float]:
        names = {parameter.name for parameter in registry.parameters_of(self.model)}
        unknown = sorted(set(parameters) - names)
        if unknown:
            raise ValueError(
                f"model {self.model} has no parameter {', '.join(map(repr, unknown))}; "
                f"allowed: {', '.join(allowed_names(self.model))}"
            )
        return parameters

    def build(self, organ: Organ) -> Model:
        """The model on an organ.

        Raises:
            ValueError: As `checked`; or the values do not go together on this organ, such as a time
                step that is not stable.
        """
        self.checked()
        constants = self.constants()
        material = self.material(organ)
        springs = None if constants is None else constants.network(organ.mesh, material)
        return registry.build(self.model, organ.mesh, material, self.parameters, springs)


def material_names() -> list[str]:
    """Numbers of the material that a subject can set."""
    return [entry.name for entry in fields(Material) if entry.name != "regions"]


def allowed_names(model: str) -> list[str]:
    """Names of all values that a subject of a model can have.

    Raises:
        ValueError: There is no such model.
    """
    return [
        *(parameter.name for parameter in registry.parameters_of(model)),
        *(MATERIAL + name for name in material_names()),
        *(SPRINGS + name for name in SpringConstants.names()),
    ]


def parse_subject(text: str) -> Subject:
    """The subject of LABEL=MODEL[:NAME=VALUE,...][@EFFORT]; "LABEL=" may be left out.

    Examples: "quasi_static:step=1.2,levels=1000@2", "soft=lr@4ms", "finite_element@rest".

    Raises:
        ValueError: It cannot be read, or names something that does not exist.
    """
    head, _, effort = text.partition("@")
    name, _, values = head.partition(":")
    label, has_label, model = name.rpartition("=")
    try:
        given = dict(_pair(item) for item in values.split(",") if item.strip())
    except ValueError as error:
        raise ValueError(
            f"{text!r} is not understood: {error}; write MODEL:NAME=VALUE,NAME=VALUE@EFFORT, for "
            "example quasi_static:step=1.2,levels=1000@2"
        ) from error
    return Subject(
        model.strip(), given, Effort.parse(effort) if effort else Effort(),
        label.strip() if has_label else "",
    ).checked()  # fmt: skip


def _pair(item: str) -> tuple[str, float]:
    name, equals, value = item.partition("=")
    if not equals:
        raise ValueError(f"{item!r} has no value")
    try:
        return name.strip(), float(value)
    except ValueError as error:
        raise ValueError(f"{value!r} of {name.strip()} is no number") from error


def _under(prefix: str, values: Mapping[str, float]) -> dict[str, float]:
    return {
        name.removeprefix(prefix): value
        for name, value in values.items()
        if name.startswith(prefix)
    }
