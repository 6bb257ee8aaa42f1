"""Which topics belong to the robot of a laser."""

import pytest

from evalkit_datasets.parsing.robots import count_common_spaces, find_foreign_topics


@pytest.mark.parametrize(
    ("laser", "lasers", "motions", "foreign"),
    [
        ("/scan", ["/scan"], ["/odom", "/tf"], []),
        ("/front/scan", ["/front/scan", "/rear/scan"], ["/odom", "/tf"], []),  # one robot with two lidars
        ("/camera/scan", ["/camera/scan"], ["/camera/odom/sample", "/wheel/odom"], []),
        ("/a/scan", ["/a/scan", "/b/scan"], ["/a/odom", "/b/odom", "/tf"], ["/b/odom", "/b/scan"]),
        ("/a/front/scan", ["/a/front/scan", "/a/rear/scan"], ["/a/front/odom", "/a/odom"], []),
        ("/fleet/a/scan", ["/fleet/a/scan", "/fleet/b/scan"], ["/fleet/a/tf", "/fleet/b/tf"],
         ["/fleet/b/scan", "/fleet/b/tf"]),
        ("/scan", ["/scan", "/b/scan"], ["/odom", "/b/odom"], ["/b/odom", "/b/scan"]),
        ("/scan", ["/scan", "/b/scan"], ["/b/odom"], []),  # then they are its own, too
        ("/a1/scan", ["/a1/scan", "/a10/scan"], ["/a1/odom", "/a10/odom"], ["/a10/odom", "/a10/scan"]),
    ],
)  # fmt: skip
def test_the_topics_of_other_robots(laser, lasers, motions, foreign):
    assert sorted(find_foreign_topics(laser, lasers, motions)) == foreign


def test_an_odometry_that_the_user_names_is_kept():
    topics = ["/scan", "/camera/scan"], ["/odom", "/camera/odom/sample", "/camera/tf"]
    assert sorted(find_foreign_topics("/scan", *topics)) == ["/camera/odom/sample", "/camera/scan", "/camera/tf"]
    assert sorted(find_foreign_topics("/scan", *topics, "camera/odom/sample")) == ["/camera/scan", "/camera/tf"]


def test_the_namespaces_that_two_topics_have_in_common_are_counted():
    assert count_common_spaces("/a/b/odom", "/a/b/scan") == 2
    assert count_common_spaces("/a/b/odom", "/a/front/b/scan") == 1
    assert count_common_spaces("/a/odom", "/a10/scan") == count_common_spaces("/odom", "/scan") == 0
