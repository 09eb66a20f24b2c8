"""Schemas of components are made when a scenario names them."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import create_model

from qrsim.models.sensors.barometer import Barometer
from qrsim.models.sensors.imu import Imu
from qrsim.scenarios import slots
from qrsim.scenarios.component_schema import component_model
from qrsim.scenarios.problems import component_types


def test_the_types_of_a_place_are_known_without_the_schema_of_a_component(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []

    def counted(name: str, component: type, **options: Any) -> Any:
        made.append(name)
        return component_model(name, component, **options)

    monkeypatch.setattr(slots, "component_model", counted)
    place: Any = slots.slot_of({"barometer": Barometer, "imu": Imu})
    model = create_model("Rack", sensor=(place, ...))
    assert component_types(model, ["sensor"]) == ["barometer", "imu"]
    # Which of the two it is, the path does not say.
    assert component_types(model, ["sensor", "type"]) == []
    assert made == []
    model.model_validate({"sensor": {"type": "barometer"}})
    assert made == ["barometer"]
