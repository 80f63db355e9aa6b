"""Where streams begin and end: devices, simulators, files, the screen."""

from typing import TYPE_CHECKING

from stream.lazy import offered

if TYPE_CHECKING:
    from devices.alarms import Alarms
    from devices.analog.labjack import LabJack
    from devices.analog.nidaq import NiDaq
    from devices.ascii_lines import AsciiLines
    from devices.binary import Binary
    from devices.bitalino import Bitalino
    from devices.ble.dot import MovellaDot
    from devices.ble.ganglion import Ganglion
    from devices.ble.heart_rate import HeartRate
    from devices.ble.polar import Polar
    from devices.ble.treadmill import FtmsTreadmill
    from devices.ble.treadmill_control import TreadmillControl
    from devices.brainflow_board import BrainflowBoard
    from devices.cameras.depth_camera import DepthCamera
    from devices.cameras.kinect import AzureKinect
    from devices.cameras.orbbec import Orbbec
    from devices.cameras.realsense import RealSense
    from devices.cyton import Cyton
    from devices.files.depth_clip import DepthClip
    from devices.files.depthai_replay import DepthaiReplay
    from devices.files.recorded_streams import RecordedStreams
    from devices.lsl import LslInlet
    from devices.mqtt import MqttSwitch
    from devices.mti import Mti
    from devices.natnet import NatNet
    from devices.oak import Oak
    from devices.osc import OscInlet
    from devices.outlets.bvh_file import BvhFile
    from devices.outlets.csv_file import CsvFile
    from devices.outlets.cycle_table import CycleTable
    from devices.outlets.exercise_panel import ExercisePanel
    from devices.outlets.lsl import LslOutlet
    from devices.outlets.mqtt import MqttOutlet
    from devices.outlets.night import NightLog
    from devices.outlets.osc import OscOutlet
    from devices.outlets.osc_points import OscPoints
    from devices.outlets.prompt_panel import PromptPanel
    from devices.outlets.report import SessionReport
    from devices.outlets.session_end import SessionEnd
    from devices.outlets.step_panel import StepPanel
    from devices.outlets.training import TrainingReport
    from devices.outlets.trigger import TriggerOutlet
    from devices.outlets.vmc import VmcOutlet
    from devices.outlets.vrchat import VrchatTrackers
    from devices.past_nights import PastNights
    from devices.pose_map.answers import PoseAnswers
    from devices.pose_map.queries import PoseQueries
    from devices.qualisys import Qualisys
    from devices.shimmer import Shimmer
    from devices.simulators.actigraph import Actigraph
    from devices.simulators.back_walker import BackWalker
    from devices.simulators.bedside import Bedside
    from devices.simulators.before_camera import BeforeCamera
    from devices.simulators.exerciser import Exerciser
    from devices.simulators.oak import SimulatedOak
    from devices.simulators.performer import Performer
    from devices.simulators.quadruped import Quadruped, TwoActors
    from devices.simulators.treadmill import Treadmill
    from devices.simulators.walkway import Walkway
    from devices.synthesis.source import Synthesis
    from devices.trigno import Trigno
    from devices.usb.endpoint import Endpoint
    from devices.vmc import Vmc

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
    "RealSense",
    "RecordedStreams",
    "SessionEnd",
    "SessionReport",
    "Shimmer",
    "SimulatedOak",
    "StepPanel",
    "Synthesis",
    "TrainingReport",
    "Treadmill",
    "TreadmillControl",
    "TriggerOutlet",
    "Trigno",
    "TwoActors",
    "Vmc",
    "VmcOutlet",
    "VrchatTrackers",
    "Walkway",
]

__getattr__, __dir__ = offered(
    __name__,
    {
        "Actigraph": "devices.simulators.actigraph",
        "Alarms": "devices.alarms",
        "AsciiLines": "devices.ascii_lines",
        "AzureKinect": "devices.cameras.kinect",
        "BackWalker": "devices.simulators.back_walker",
        "Bedside": "devices.simulators.bedside",
        "BeforeCamera": "devices.simulators.before_camera",
        "Binary": "devices.binary",
        "Bitalino": "devices.bitalino",
        "BrainflowBoard": "devices.brainflow_board",
        "BvhFile": "devices.outlets.bvh_file",
        "CsvFile": "devices.outlets.csv_file",
        "CycleTable": "devices.outlets.cycle_table",
        "Cyton": "devices.cyton",
        "DepthCamera": "devices.cameras.depth_camera",
        "DepthClip": "devices.files.depth_clip",
        "DepthaiReplay": "devices.files.depthai_replay",
        "Endpoint": "devices.usb.endpoint",
        "ExercisePanel": "devices.outlets.exercise_panel",
        "Exerciser": "devices.simulators.exerciser",
        "FtmsTreadmill": "devices.ble.treadmill",
        "Ganglion": "devices.ble.ganglion",
        "HeartRate": "devices.ble.heart_rate",
        "LabJack": "devices.analog.labjack",
        "LslInlet": "devices.lsl",
        "LslOutlet": "devices.outlets.lsl",
        "MovellaDot": "devices.ble.dot",
        "MqttOutlet": "devices.outlets.mqtt",
        "MqttSwitch": "devices.mqtt",
        "Mti": "devices.mti",
        "NatNet": "devices.natnet",
        "NiDaq": "devices.analog.nidaq",
        "NightLog": "devices.outlets.night",
        "Oak": "devices.oak",
        "Orbbec": "devices.cameras.orbbec",
        "OscInlet": "devices.osc",
        "OscOutlet": "devices.outlets.osc",
        "OscPoints": "devices.outlets.osc_points",
        "PastNights": "devices.past_nights",
        "Performer": "devices.simulators.performer",
        "Polar": "devices.ble.polar",
        "PoseAnswers": "devices.pose_map.answers",
        "PoseQueries": "devices.pose_map.queries",
        "PromptPanel": "devices.outlets.prompt_panel",
        "Quadruped": "devices.simulators.quadruped",
        "Qualisys": "devices.qualisys",
        "RealSense": "devices.cameras.realsense",
        "RecordedStreams": "devices.files.recorded_streams",
        "SessionEnd": "devices.outlets.session_end",
        "SessionReport": "devices.outlets.report",
        "Shimmer": "devices.shimmer",
        "SimulatedOak": "devices.simulators.oak",
        "StepPanel": "devices.outlets.step_panel",
        "Synthesis": "devices.synthesis.source",
        "TrainingReport": "devices.outlets.training",
        "Treadmill": "devices.simulators.treadmill",
        "TreadmillControl": "devices.ble.treadmill_control",
        "TriggerOutlet": "devices.outlets.trigger",
        "Trigno": "devices.trigno",
        "TwoActors": "devices.simulators.quadruped",
        "Vmc": "devices.vmc",
        "VmcOutlet": "devices.outlets.vmc",
        "VrchatTrackers": "devices.outlets.vrchat",
        "Walkway": "devices.simulators.walkway",
    },
)
