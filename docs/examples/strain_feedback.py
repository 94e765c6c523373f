"""Controller on laboratory sensors: flexman evaluate docs/examples/strain_feedback.py --env FlexRotary-v0/unknown-lab"""

import numpy as np


class StrainFeedback:
    """PD of the motor, and feedback of the bending strain at the root of the link."""

    sensors = ("lab",)  # encoders on both sides of the joint, strain gauges, and the commanded motion

    def __init__(self, torque_limit, stiffness=1.15, damping=0.08, strain=300.0):
        self.torque_limit = np.array(torque_limit)  # N m
        self.stiffness, self.damping, self.strain = stiffness, damping, strain  # N m/rad, N m s/rad, N m

    def reset(self, arms, episode, count):
        """Start new episodes; nothing is stored between control periods."""

    def act(self, readings, applied, active):
        error = readings["angle_command"] - readings["motor_angles"]  # (b, 1), rad
        bending = readings["root_strains"][:, :1]
        torque = self.stiffness * error - self.damping * readings["motor_rates"] - self.strain * bending
        return np.clip(torque / self.torque_limit, -1.0, 1.0)


def make(plant):
    """Feedback of motor angle and strain, tuned by hand."""
    return StrainFeedback(plant.torque_limit)
