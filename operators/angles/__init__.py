"""Anatomical angles of joints, as gait laboratories report them."""

from kinegraph.operators.angles.joint_angles import JointAngles

__all__ = ["JointAngles"]
