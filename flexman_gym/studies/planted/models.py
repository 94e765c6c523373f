"""Models: planted errors in scenes, in models and in what moves them through time."""

from flexman_gym.studies.planted.change import changes

MODEL = (
    *changes(
        "model", "model/stations.py", "model/test_stations.py model/test_stiffening.py",
        ("stations of a stepped link are weighed by its first section",
         "each.density * each.area for each, _, length, _ in elements",
         "elements[0].section.density * elements[0].section.area for _, _, length, _ in elements"),
        ("stations lump the mass at wrong places", "masses.sum() * vectors[0] ** 2", "masses.sum() * vectors[1] ** 2"),
        ("G is summed over half of the base", "sums[:, : i + 2] +=", "sums[:, i : i + 2] +="),
    ),
    *changes(
        "model", "model/element.py", "model/test_beam.py model/test_stiffening.py",
        ("bending stiffness of a wrong moment", "link.youngs_modulus * link.second_moment_y * bending * np.outer",
         "link.youngs_modulus * link.second_moment_z * bending * np.outer"),
        ("a Hermite cubic with a wrong sign", "length * xi**2 * (xi - 1),", "length * xi**2 * (1 - xi),"),
        ("torsion by Young's modulus", "link.shear_modulus * link.torsion_constant * bar",
         "link.youngs_modulus * link.torsion_constant * bar"),
        ("section points exchanged", "np.array([[y, 0], [-y, 0], [0, z], [0, -z]])",
         "np.array([[z, 0], [-z, 0], [0, y], [0, -y]])"),
        ("theta_y = w'", "slope * [1.0, -1.0, 1.0, -1.0]", "slope * [1.0, 1.0, 1.0, 1.0]"),
    ),
    *changes(
        "model", "model/beam.py", "model/test_beam.py model/test_rotary_inertia.py model/test_links.py",
        ("half of the polar inertia", "section.density * (section.second_moment_y + section.second_moment_z)",
         "section.density * section.second_moment_y"),
        ("spinning sections have no shape integrals", "half = beam.polar @ beam.twist / 2",
         "half = 0.0 * beam.polar @ beam.twist"),
        ("the twist of a section is that of the other end", "(1 - abscissae) / 2, (1 + abscissae) / 2",
         "(1 + abscissae) / 2, (1 - abscissae) / 2"),
    ),
    *changes(
        "model", "model/modes.py", "model/test_modes.py model/test_rotary_inertia.py simulation/test_energy.py",
        ("modes do not see the payload's inertia", "inertia[3:, 3:] += mount @", "inertia[3:, 3:] += 0.0 * mount @"),
        ("modes carry nothing", "tip.T @ outboard @ tip, beam.stiffness",
         "0.0 * tip.T @ outboard @ tip, beam.stiffness"),
        ("half of the modal damping", "return 2.0 * ratio * inverse", "return 1.0 * ratio * inverse"),
        ("links before do not turn what is outboard", "inertia = rotation @ total @ rotation.T", "inertia = total"),
    ),
    *changes(
        "model", "model/packing.py", "simulation/test_effects.py model/test_links.py",
        ("no link is damped in proportion", "arm.stiffness_proportional_damping * stiffness + modal",
         "0.0 * stiffness + modal"),
        ("axes in the frame of the base", "np.array(li.orientation).T @ jo.axis", "np.array(li.orientation) @ jo.axis"),
        ("dropped integrals", "VANISHING = 1e-14", "VANISHING = 1e-1"),
    ),
    *changes(
        "model", "model/instant.py",
         "model/test_frequencies.py model/test_linearization.py model/test_inverse_dynamics.py",
        ("locked frequencies keep the motors free",
         "np.setdiff1d(np.arange(model.n_dof), model.motor_columns)\n        mass",
         "np.arange(model.n_dof)\n        mass"),
        ("frequencies in rad/s", "np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)",
         "np.sqrt(np.maximum(squares, 0.0))"),
        ("viscous friction is not in the damping matrix", "+= model.constants.viscous_friction", "+= 0.0"),
        ("a rotor does not run ahead", "(motion[2, sprung] + runs_ahead)", "motion[2, sprung]"),
        ("inverse dynamics forgets friction", "+ constants.viscous_friction * motion[1]", "+ 0.0 * motion[1]"),
    ),
    *changes(
        "model", "model/instant.py", "model/test_instant.py",
    ),
    *changes(
        "model", "model/linear.py", "model/test_linearization.py simulation/test_friction.py",
        ("the slope of Coulomb friction at rest everywhere", "/ np.cosh(v[motors] / constants.coulomb_rate) ** 2", ""),
        ("no damping in the linear model", "= -damping_matrix(model) - ", "= - "),
    ),
    *changes(
        "model", "model/statics.py", "model/test_statics.py",
        ("holding torques without springs", "+ stiffness_matrix(model) @ x)[model.motor_columns]",
         ")[model.motor_columns]"),
        ("rest is taken far from balance", "if not change <= statics.ROUNDING:", "if not change <= 1e9:"),
    ),
    *changes(
        "model", "model/strain.py", "model/test_strain.py",
        ("strain with the other sign of y", 'float(stretch - finite("y"', 'float(stretch + finite("y"'),
    ),
)  # fmt: skip

SIMULATION = (
    *changes(
        "simulation", "simulation/movers.py", "simulation/test_batch.py",
        ("parameters do not reach arms that are moved one by one",
         "self._runs[arm].constants = self._runs[arm].constants._replace(**constants)", "pass"),
        ("arms that are moved one by one share their clock", "(periods[arm] * self._period, self._step",
         "(0.0 * self._period, self._step",
         "the drive of a control period is constant, so that no method reads the clock"),
        ("the last group of arms is not moved", "bounds = np.linspace(0, groups, len",
         "bounds = np.linspace(0, groups - 1, len"),
    ),
    *changes(
        "simulation", "simulation/batch.py", "simulation/test_batch.py simulation/test_simulator.py",
        ("the turnover of energy outlives a reset",
         "self._start_energy[arms], self.energy_turnover[arms] = energy[arms], 0.0",
         "self._start_energy[arms] = energy[arms]"),
        ("the ledger outlives a reset", "self.rows[arms, :-2], self.rows[arms, -2:] = states, 0.0",
         "self.rows[arms, :-2] = states"),
        ("time goes on in arms that have failed", "self._periods += moved", "self._periods += 1"),
    ),
    *changes(
        "simulation", "kernels/outputs.py", "simulation/test_batch.py simulation/test_simulator.py",
        ("gravitational energy is turned over", "outputs[b, JOINT_ENERGY] + outputs[b, LINK_ENERGY]\n",
         "outputs[b, JOINT_ENERGY] + outputs[b, LINK_ENERGY] + outputs[b, GRAVITATIONAL]\n"),
        ("dissipation has the wrong sign", "rows[b, last - 1] - rows[b, last] -",
         "rows[b, last - 1] + rows[b, last] -"),
    ),
    *changes(
        "simulation", "simulation/parameters.py", "simulation/test_batch.py",
        ("a heavier payload keeps its inertia", '"payload_inertia": heavier * nominal.payload_inertia',
         '"payload_inertia": nominal.payload_inertia'),
        ("modal damping does not follow stiffness", "+ np.sqrt(factor) * model.modal_damping", "+ model.modal_damping"),
        ("carried rotors keep their inertia", '"carried_inertia": inertia * model',
         '"carried_inertia": 0.0 * inertia * model'),
    ),
    *changes(
        "simulation", "simulation/simulator.py", "simulation/test_simulator.py simulation/test_drive.py",
        ("a prescribed acceleration is dropped", "drive[self.prescribed] = given[self.prescribed]",
         "drive[self.prescribed] = 0.0"),
        ("the base force of the last period stays", "        drive[n + 3 :] = 0.0\n", ""),
        ("a failed arm may go on", "if self.status != STATUS[layout.OK]:\n            raise",
         "if False:\n            raise"),
    ),
    *changes(
        "simulation", "simulation/trajectory.py", "simulation/test_trajectory.py simulation/test_simulator.py",
        ("the turnover is that of the moment", "return np.maximum.accumulate(parts)", "return parts"),
        ("the alarm tells the last time", "float(self.time[late[0]])", "float(self.time[late[-1]])"),
    ),
    *changes(
        "simulation", "simulation/methods.py", "simulation/test_methods.py",
        ("ros2 with another gamma", "gamma = 1 - math.sqrt(0.5)", "gamma = 0.5"),
    ),
    *changes(
        "simulation", "simulation/run.py", "simulation/test_methods.py",
        ("parts of a run begin at its start", "time=clock.time + (first + piece / pieces) * span", "time=clock.time"),
    ),
    *changes(
        "simulation", "simulation/explanation.py", "simulation/test_explanation.py",
        ("what went last is named", "row = int(late[0]) if", "row = int(late[-1]) if"),
        ("the stable step is twice too long", "stable = limit / (2.0", "stable = limit / (1.0"),
    ),
    *changes(
        "simulation", "scene/drive.py", "simulation/test_drive.py scene/test_parts.py",
        ("a signal does not begin", "self.phase, self.start, stop])", "self.phase, 0.0, stop])"),
    ),
    *changes(
        "simulation", "scene/scene.py", "scene/test_scene.py simulation/test_explanation.py",
        ("a scene forgets its whole state", 'store(self, state=vector("Initial.state", self.state))',
         "store(self, state=None)"),
    ),
)  # fmt: skip
