"""Machines are found by name, and only machines."""

import pytest

from pkm_cnc.errors import InputError
from pkm_cnc.kinematics import load_kinematics
from pkm_cnc.kinematics.tripod import Tripod
from pkm_cnc.parameters import parameters_of


def test_a_machine_is_loaded_by_name():
    assert load_kinematics("tripod") is Tripod


@pytest.mark.parametrize("name", ["", "tripods", "Tripod", "machine", "_pointwise", "os", "..errors", "tripod.Tripod"])
def test_another_name_is_refused_with_the_machines_there_are(name):
    with pytest.raises(InputError, match=r"^kinematics: '.*' is unknown; there are .*\btripod\b") as caught:
        load_kinematics(name)
    assert "machine" not in str(caught.value).partition("there are")[2]
    assert "_pointwise" not in str(caught.value).partition("there are")[2]


def test_every_geometry_parameter_has_its_meaning_and_unit():
    for spec in parameters_of(Tripod.Geometry):
        assert spec.doc
        assert spec.unit in ("m", "rad")
