"""Lists and arrays accepted as numbers, and names reached through `fm`; `make lint` checks their types."""

from typing import assert_type

import numpy as np

import flexman_gym as fm

one, three, turn = np.zeros(1), np.array([0.0, 0.0, 1.0]), np.eye(3)
link = fm.Link(1.0, 1e-4, 1e-9, 1e-9, 2e-9, 7e10, 2.6e10, 2700.0, orientation=turn)
arm = fm.Arm([link], [fm.Joint(three, 0.1, 20.0)], fm.Payload(1.0, turn, three), gravity=three)
scene = fm.Scene(arm, fm.ModelChoice(True, 1), fm.ConstantTorque(one), fm.Initial(one, one), 1.0, 0.1)
model = fm.build_model(fm.catalog.paper_rrr(gravity=three))
fm.frequencies(model, three), fm.rest_state(model, three), fm.linearize(model, three)
fm.Simulator(model).step(three)
limits = [float(each) for each in three]
fm.frequencies(model, limits), fm.Joint(limits)
assert_type(fm.control.PD(limits, limits, [1.0] * 3), fm.control.PD), fm.tune
