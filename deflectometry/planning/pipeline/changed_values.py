"""A measurement.toml with other values of some keys, as the alternatives of a plan have them."""

from collections.abc import Mapping
from typing import Any, TypeVar

from heliogauge.measurement.models import MeasurementModel

_Model = TypeVar("_Model", bound=MeasurementModel)


def changed_model(model: _Model, values: Mapping[str, Any]) -> _Model:
    """Return a model with other values of keys, as if its file had said so; keys as "table.key".

    InputError, ValueError: As for the file.
    """
    content = model.model_dump(exclude_unset=True)
    for key, value in values.items():
        *path, last = key.split(".")
        table = content
        for name in path:
            table = table.setdefault(name, {})
        table[last] = value
    return type(model).model_validate(content)


def value_of(model: Any, key: str) -> Any:
    """Return the value of a key; None where a table of it is not there."""
    for name in key.split("."):
        model = getattr(model, name, None)
    return model
