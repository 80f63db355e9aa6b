"""A pose network on the camera: the part of the pipeline from colour images and depth to key points in space.

The network itself and the camera can be made only with a camera; what follows them (`located`) runs on this computer as well.
"""

from __future__ import annotations

from contextlib import suppress
from datetime import timedelta
from functools import cache
from typing import Any, Protocol

QUEUE = 8
WAITING = 16
"""Depth frames that wait for the network's word on the image of the same moment: half a second at 30 fps."""
NEAREST_MM, FARTHEST_MM = 200, 10_000
"""Depths in between count."""
RADIUS = 0.01
"""Pixels so near to a key point count, in widths of the frame."""


class WantedNetwork(Protocol):
    """What is asked of a camera for its network: parameters of `devices.oak.Oak`."""

    @property
    def network(self) -> str: ...

    @property
    def width(self) -> int: ...

    @property
    def fps(self) -> float: ...


def apart_s(fps: float) -> float:
    """An image and a depth frame that were taken further apart than this are no pair."""
    return min(0.02, 0.4 / fps)


def on_camera(dai: Any, pipeline: Any, of: WantedNetwork, depth: Any, colour: Any) -> Any:
    """The queue of what the network in the archive `of.network` sees in the images of the camera `colour`, with places in space.

    depth, colour   the pipeline's nodes: StereoDepth, aligned to colour, and Camera

    Written after depthai's documentation; not tried on a camera. The whole image is shown to the network, within borders if need be:
    depthai would cut off its sides.
    """
    network = pipeline.create(dai.node.DetectionNetwork).build(
        input=colour, model=dai.NNArchive(of.network), fps=of.fps, resizeMode=dai.ImgResizeMode.LETTERBOX
    )
    return located(dai, pipeline, of, depth.depth, network.out)


def located(dai: Any, pipeline: Any, of: WantedNetwork, depth: Any, detections: Any) -> Any:
    """The queue of SpatialImgDetections, made of two outputs: depth frames, and ImgDetections with key points in the network's image.

    Only what was taken within `apart_s` comes together: depthai's calculator alone pairs what happens to wait, and a network's word on an
    image comes later than its depth. Key points are carried over into the depth's image first, which the calculator leaves undone
    (depthai 3.12: it measures them at the same shares of the depth's image). All of it runs on this computer, to which depth comes anyway.
    """
    sync, places = pipeline.create(dai.node.Sync), pipeline.create(dai.node.SpatialLocationCalculator)
    carried = pipeline.create(_carrier(dai))
    for node in (sync, places):
        node.setRunOnHost(True)
    sync.setSyncThreshold(timedelta(seconds=apart_s(of.fps)))
    sync.setSyncAttempts(-1)  # nothing is sent but pairs
    config = places.initialConfig
    config.setCalculateSpatialKeypoints(True)
    config.setCalculationAlgorithm(dai.SpatialLocationCalculatorAlgorithm.MEDIAN)
    config.setKeypointRadius(max(1, round(RADIUS * of.width)))
    config.setDepthThresholds(NEAREST_MM, FARTHEST_MM)
    for name, output in (("depth", depth), ("detections", detections)):
        entry = sync.inputs[name]
        entry.setBlocking(False)
        entry.setMaxSize(WAITING)
        output.link(entry)
    sync.out.link(carried.pairs)
    carried.depth.link(places.inputDepth)
    carried.detections.link(places.inputDetections)
    return places.outputDetections.createOutputQueue(maxSize=QUEUE, blocking=False)


def carried_over(detections: Any, depth: Any) -> Any:
    """ImgDetections in the image of a depth frame, perhaps of another lens, cut or without borders.

    A point outside the image gets the confidence 0: depthai takes shares above 1 for pixels, of which it makes places in the image.
    """
    for person in detections.detections:
        points = person.getKeypoints()
        for point in points:
            at = point.imageCoordinates
            if not (0 <= at.x <= 1 and 0 <= at.y <= 1):
                point.confidence = 0.0
        person.setKeypoints(points)
    return detections.transformTo(depth.getTransformation())


@cache
def _carrier(dai: Any) -> type[Any]:
    """The host node that takes pairs apart; its class can only be made when depthai is there."""

    class Carrier(dai.node.ThreadedHostNode):  # type: ignore[misc]
        """Pairs in; depth and detections out, the latter in the image of the former."""

        def __init__(self) -> None:
            dai.node.ThreadedHostNode.__init__(self)
            self.pairs = self.createInput()
            self.depth, self.detections = self.createOutput(), self.createOutput()

        def run(self) -> None:
            with suppress(dai.MessageQueue.QueueException):  # the pipeline was closed
                while self.isRunning():
                    pair = self.pairs.get()
                    seen = carried_over(pair["detections"], pair["depth"])
                    self.depth.send(pair["depth"])
                    self.detections.send(seen)

    return Carrier
