"""Messages of detections in their several versions: what is in them, without a bag."""

from __future__ import annotations

import math
from types import SimpleNamespace as Message
from typing import Any

import pytest

from data.formats.bags.reading import FLAT_BOXES, TAGS, Detection, detections


def header(frame: str, seconds: int = 5) -> Any:
    return Message(frame_id=frame, stamp=Message(sec=seconds, nanosec=0))


def point(x: float, y: float, z: float = 0.0) -> Any:
    return Message(x=x, y=y, z=z)


def found(kind: str, message: Any) -> list[Detection]:
    return list(detections(kind, message, 9.0))


def test_a_bundle_of_tags_has_no_number_of_its_own():
    def tag(numbers: list[int]) -> Any:
        pose = Message(header=header(""), pose=Message(pose=Message(position=point(1.0, 2.0, 3.0))))
        return Message(id=numbers, pose=pose)

    message = Message(header=header("/camera"), detections=[tag([4]), tag([5, 6])])
    assert found(TAGS, message) == [
        Detection(5.0, "camera", 4, (1.0, 2.0, 3.0)),
        Detection(5.0, "camera", -1, (1.0, 2.0, 3.0)),
    ]


@pytest.mark.parametrize("centre", [Message(x=3.0, y=4.0), Message(position=Message(x=3.0, y=4.0))])
def test_boxes_in_an_image_are_pixels_in_either_version(centre):
    box = Message(header=header(""), bbox=Message(center=centre), id="8")
    (seen,) = found(FLAT_BOXES, Message(header=header("optical"), detections=[box]))
    assert (seen.stamp, seen.frame, seen.id, seen.at[:2]) == (5.0, "optical", 8, (3.0, 4.0))
    assert math.isnan(seen.at[2])
