"""pytest plug-in: the marker ``evalkit`` states a comparison, the fixture ``evalkit_results`` runs it.

@pytest.mark.evalkit("drive.mcap", methods=["my_icp:MyIcp"], ground_truth="drive.tum")
def test_my_icp_drifts_less_than_5_cm(evalkit_results):
    evalkit_results.require("ate_rmse_m", "my_icp:MyIcp", below=0.05)

This module imports nothing of evalkit until the fixture is used: every pytest run of an environment loads it.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from evalkit.api.results import ComparisonResults


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marker."""
    config.addinivalue_line("markers", "evalkit(recording, ...): the arguments of evalkit.compare for evalkit_results")


@pytest.fixture
def evalkit_results(request: pytest.FixtureRequest, tmp_path: Path) -> ComparisonResults:
    """Return the results of the comparison that the marker ``evalkit`` of the test states."""
    import evalkit  # noqa: PLC0415 - see above

    marker = request.node.get_closest_marker("evalkit")
    if marker is None or not marker.args:
        pytest.fail("evalkit_results needs a marker: @pytest.mark.evalkit(RECORDING, methods=[...])", pytrace=False)
    options = {"out": str(tmp_path), **marker.kwargs}
    return evalkit.compare(*marker.args, **options)
