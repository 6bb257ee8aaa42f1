"""The table of stage configurations that the paper leaves open."""

import pytest

from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit_paper import stage_configurations
from evalkit_paper.stage_configurations import CHAPTER, CONFIGURATIONS


def test_every_configuration_is_valid_for_the_front_end():
    for each in CONFIGURATIONS:
        spec = registry.backend(each.backend)
        frontend.complete_parameters(each.name, spec, each.parameters)


def test_names_of_configurations_differ():
    assert len({each.name for each in CONFIGURATIONS}) == len(CONFIGURATIONS)


def test_without_stages_there_are_no_iterations_and_the_result_is_the_odometry():
    odometry = stage_configurations.measure_configuration(
        backend="paper",
        parameters=dict(CONFIGURATIONS[0].parameters),
        sequence={"laps": 0.05, "rate_hz": 5.0, "velocity_noise_mps": 0.0, "odometry_scale": 0.0, "gyro_noise_dps": 0.0,
                  "gyro_bias_dps": 0.0},
    )  # fmt: skip
    assert odometry["s2s"] is odometry["s2m"] is None
    assert odometry["ate_m"] == pytest.approx(0.0, abs=1e-9)
    assert odometry["final_percent"] == pytest.approx(0.0, abs=1e-6)


def test_the_table_has_a_row_for_every_configuration():
    settings = CHAPTER.settings("test", {"laps": 0.05, "rate_hz": 5.0, "seeds": 2})
    made = {}
    for task in CHAPTER.tasks(settings):
        first = next(iter(made.values()), None) or task.run()[0]
        made[task.name] = {**first, "s2s": 3.0, "s2m": 4.0}
    (section,) = CHAPTER.sections(settings, made)
    table = section.blocks[1]
    assert [row[0] for row in table.rows] == [each.name for each in CONFIGURATIONS]
    (finding,) = CHAPTER.findings(settings, made)
    assert finding.anchor == section.anchor
    assert finding.judgement.verdict == "not reproduced"  # here every reading drifts as much as the odometry
