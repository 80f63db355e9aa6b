"""Where streams begin and end: devices, simulators, files, the screen."""

from typing import TYPE_CHECKING

from kinegraph.stream.system.lazy import offered

if __name__ != "kinegraph.devices":
    raise ImportError("the package is kinegraph.devices: write `from kinegraph.devices import ...`")

if TYPE_CHECKING:
    from kinegraph.devices.analog.labjack import LabJack
    from kinegraph.devices.analog.nidaq import NiDaq
    from kinegraph.devices.bitalino import Bitalino
    from kinegraph.devices.brainflow import BrainflowBoard
    from kinegraph.devices.cameras.depth_camera import DepthCamera
    from kinegraph.devices.cameras.kinect import AzureKinect
    from kinegraph.devices.cameras.orbbec import Orbbec
    from kinegraph.devices.cameras.realsense import RealSense
    from kinegraph.devices.cameras.video import Video
    from kinegraph.devices.cyton import Cyton
    from kinegraph.devices.dot import MovellaDot
    from kinegraph.devices.fitness_treadmill import FtmsTreadmill
    from kinegraph.devices.fitness_treadmill.control import TreadmillControl
    from kinegraph.devices.frames import Binary
    from kinegraph.devices.ganglion import Ganglion
    from kinegraph.devices.heart_rate import HeartRate
    from kinegraph.devices.lines import AsciiLines
    from kinegraph.devices.lsl import LslInlet, LslOutlet
    from kinegraph.devices.mqtt import MqttOutlet, MqttSwitch
    from kinegraph.devices.mti import Mti
    from kinegraph.devices.mti.back_walker import BackWalker
    from kinegraph.devices.natnet import NatNet
    from kinegraph.devices.nats import StreamInlet, StreamOutlet
    from kinegraph.devices.oak import Oak
    from kinegraph.devices.oak.simulator import SimulatedOak
    from kinegraph.devices.osc import OscInlet, OscOutlet
    from kinegraph.devices.osc.points import OscPoints
    from kinegraph.devices.osc.vmc_inlet import Vmc
    from kinegraph.devices.osc.vmc_outlet import VmcOutlet
    from kinegraph.devices.osc.vrchat import VrchatTrackers
    from kinegraph.devices.outlets.bvh_file import BvhFile
    from kinegraph.devices.outlets.csv_file import CsvFile
    from kinegraph.devices.outlets.session_end import SessionEnd
    from kinegraph.devices.outlets.terminal.alarms import Alarms
    from kinegraph.devices.outlets.terminal.cycle_table import CycleTable
    from kinegraph.devices.outlets.terminal.exercise_panel import ExercisePanel
    from kinegraph.devices.outlets.terminal.prompt_panel import PromptPanel
    from kinegraph.devices.outlets.terminal.readout import Readout
    from kinegraph.devices.outlets.terminal.step_panel import StepPanel
    from kinegraph.devices.outlets.trigger import TriggerOutlet
    from kinegraph.devices.page.map.answers import PoseAnswers
    from kinegraph.devices.page.map.queries import PoseQueries
    from kinegraph.devices.people.actigraph import Actigraph
    from kinegraph.devices.people.bedside import Bedside
    from kinegraph.devices.people.before_camera import BeforeCamera
    from kinegraph.devices.people.exerciser import Exerciser
    from kinegraph.devices.people.performer import Performer
    from kinegraph.devices.people.quadruped import Quadruped, TwoActors
    from kinegraph.devices.people.treadmill import Treadmill
    from kinegraph.devices.people.walkway import Walkway
    from kinegraph.devices.polar import Polar
    from kinegraph.devices.qualisys import Qualisys
    from kinegraph.devices.recorded.depth_clip import DepthClip
    from kinegraph.devices.recorded.depthai_replay import DepthaiReplay
    from kinegraph.devices.recorded.recorded_streams import RecordedStreams
    from kinegraph.devices.reports.night import NightLog
    from kinegraph.devices.reports.night.past_nights import PastNights
    from kinegraph.devices.reports.session import SessionReport
    from kinegraph.devices.reports.training import TrainingReport
    from kinegraph.devices.shimmer import Shimmer
    from kinegraph.devices.trigno import Trigno
    from kinegraph.devices.usb.endpoint import Endpoint

__all__ = [
    "Actigraph",
    "Alarms",
    "AsciiLines",
    "AzureKinect",
    "BackWalker",
    "Bedside",
    "BeforeCamera",
    "Binary",
    "Bitalino",
    "BrainflowBoard",
    "BvhFile",
    "CsvFile",
    "CycleTable",
    "Cyton",
    "DepthCamera",
    "DepthClip",
    "DepthaiReplay",
    "Endpoint",
    "ExercisePanel",
    "Exerciser",
    "FtmsTreadmill",
    "Ganglion",
    "HeartRate",
    "LabJack",
    "LslInlet",
    "LslOutlet",
    "MovellaDot",
    "MqttOutlet",
    "MqttSwitch",
    "Mti",
    "NatNet",
    "NiDaq",
    "NightLog",
    "Oak",
    "Orbbec",
    "OscInlet",
    "OscOutlet",
    "OscPoints",
    "PastNights",
    "Performer",
    "Polar",
    "PoseAnswers",
    "PoseQueries",
    "PromptPanel",
    "Quadruped",
    "Qualisys",
    "Readout",
    "RealSense",
    "RecordedStreams",
    "SessionEnd",
    "SessionReport",
    "Shimmer",
    "SimulatedOak",
    "StepPanel",
    "StreamInlet",
    "StreamOutlet",
    "TrainingReport",
    "Treadmill",
    "TreadmillControl",
    "TriggerOutlet",
    "Trigno",
    "TwoActors",
    "Video",
    "Vmc",
    "VmcOutlet",
    "VrchatTrackers",
    "Walkway",
]

__getattr__, __dir__ = offered(
    __name__,
    {
        "Actigraph": "kinegraph.devices.people.actigraph",
        "Alarms": "kinegraph.devices.outlets.terminal.alarms",
        "AsciiLines": "kinegraph.devices.lines",
        "AzureKinect": "kinegraph.devices.cameras.kinect",
        "BackWalker": "kinegraph.devices.mti.back_walker",
        "Bedside": "kinegraph.devices.people.bedside",
        "BeforeCamera": "kinegraph.devices.people.before_camera",
        "Binary": "kinegraph.devices.frames",
        "Bitalino": "kinegraph.devices.bitalino",
        "BrainflowBoard": "kinegraph.devices.brainflow",
        "BvhFile": "kinegraph.devices.outlets.bvh_file",
        "CsvFile": "kinegraph.devices.outlets.csv_file",
        "CycleTable": "kinegraph.devices.outlets.terminal.cycle_table",
        "Cyton": "kinegraph.devices.cyton",
        "DepthCamera": "kinegraph.devices.cameras.depth_camera",
        "DepthClip": "kinegraph.devices.recorded.depth_clip",
        "DepthaiReplay": "kinegraph.devices.recorded.depthai_replay",
        "Endpoint": "kinegraph.devices.usb.endpoint",
        "ExercisePanel": "kinegraph.devices.outlets.terminal.exercise_panel",
        "Exerciser": "kinegraph.devices.people.exerciser",
        "FtmsTreadmill": "kinegraph.devices.fitness_treadmill",
        "Ganglion": "kinegraph.devices.ganglion",
        "HeartRate": "kinegraph.devices.heart_rate",
        "LabJack": "kinegraph.devices.analog.labjack",
        "LslInlet": "kinegraph.devices.lsl",
        "LslOutlet": "kinegraph.devices.lsl",
        "MovellaDot": "kinegraph.devices.dot",
        "MqttOutlet": "kinegraph.devices.mqtt",
        "MqttSwitch": "kinegraph.devices.mqtt",
        "Mti": "kinegraph.devices.mti",
        "NatNet": "kinegraph.devices.natnet",
        "NiDaq": "kinegraph.devices.analog.nidaq",
        "NightLog": "kinegraph.devices.reports.night",
        "Oak": "kinegraph.devices.oak",
        "Orbbec": "kinegraph.devices.cameras.orbbec",
        "OscInlet": "kinegraph.devices.osc",
        "OscOutlet": "kinegraph.devices.osc",
        "OscPoints": "kinegraph.devices.osc.points",
        "PastNights": "kinegraph.devices.reports.night.past_nights",
        "Performer": "kinegraph.devices.people.performer",
        "Polar": "kinegraph.devices.polar",
        "PoseAnswers": "kinegraph.devices.page.map.answers",
        "PoseQueries": "kinegraph.devices.page.map.queries",
        "PromptPanel": "kinegraph.devices.outlets.terminal.prompt_panel",
        "Quadruped": "kinegraph.devices.people.quadruped",
        "Qualisys": "kinegraph.devices.qualisys",
        "Readout": "kinegraph.devices.outlets.terminal.readout",
        "RealSense": "kinegraph.devices.cameras.realsense",
        "RecordedStreams": "kinegraph.devices.recorded.recorded_streams",
        "SessionEnd": "kinegraph.devices.outlets.session_end",
        "SessionReport": "kinegraph.devices.reports.session",
        "Shimmer": "kinegraph.devices.shimmer",
        "SimulatedOak": "kinegraph.devices.oak.simulator",
        "StepPanel": "kinegraph.devices.outlets.terminal.step_panel",
        "StreamInlet": "kinegraph.devices.nats",
        "StreamOutlet": "kinegraph.devices.nats",
        "TrainingReport": "kinegraph.devices.reports.training",
        "Treadmill": "kinegraph.devices.people.treadmill",
        "TreadmillControl": "kinegraph.devices.fitness_treadmill.control",
        "TriggerOutlet": "kinegraph.devices.outlets.trigger",
        "Trigno": "kinegraph.devices.trigno",
        "TwoActors": "kinegraph.devices.people.quadruped",
        "Video": "kinegraph.devices.cameras.video",
        "Vmc": "kinegraph.devices.osc.vmc_inlet",
        "VmcOutlet": "kinegraph.devices.osc.vmc_outlet",
        "VrchatTrackers": "kinegraph.devices.osc.vrchat",
        "Walkway": "kinegraph.devices.people.walkway",
    },
)
