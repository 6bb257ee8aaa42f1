"""A bag without definitions is read with the types that its messages consist of."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rosbags")

from evalkit_datasets.parsing.bag_types import NeededTypes


@pytest.mark.parametrize(
    ("kind", "needed"),
    [
        (
            "sensor_msgs/msg/LaserScan",
            {"sensor_msgs/msg/LaserScan", "std_msgs/msg/Header", "builtin_interfaces/msg/Time"},
        ),
        (
            "tf2_msgs/msg/TFMessage",
            {
                "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped", "geometry_msgs/msg/Transform",
                "geometry_msgs/msg/Vector3", "geometry_msgs/msg/Quaternion", "std_msgs/msg/Header",
                "builtin_interfaces/msg/Time",
            },
        ),
        ("somebody_msgs/msg/Own", set()),
    ],
)  # fmt: skip
def test_the_types_of_a_message_are_its_own_and_those_of_its_parts(kind, needed):
    types = NeededTypes()
    types.reader = SimpleNamespace(readers=[SimpleNamespace(connections=[SimpleNamespace(msgtype=kind)])])
    assert set(types.fielddefs) == needed
