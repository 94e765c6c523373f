"""Page of published arms: printed, measured and computed results beside those of this package."""

from collections.abc import Sequence

from flexman_gym.common.markdown import markdown_table
from flexman_gym.toolbox.verification.papers import REASONS
from flexman_gym.toolbox.verification.table import PASS, SHOWN, VerificationRow
from studies.verification.two_mass import TwoMassRow, two_mass_table

PAGE = """# Arms of published papers

The catalogue has arms whose parameters papers print in full: `flexman list arms` prints their names, and
`help(fm.catalog.gu_2005)` the source and the choices behind one of them. `flexman verify papers` computes the tables of
this page in less than a minute, with compiled kernels.

DOI of the sources: [10.1186/s40648-018-0125-7](https://doi.org/10.1186/s40648-018-0125-7) (Gifu University),
[10.1109/87.654874](https://doi.org/10.1109/87.654874) (Apkarian and Adams),
[10.1115/DETC2007-35511](https://doi.org/10.1115/DETC2007-35511) (NASA JSC).

What a source leaves open is stated with the arm. The length of the strip of Quanser's rotary link is 0.419 m in the
data sheet and 0.381 m in the model file; a measured response does not say which of them it belongs to, and both are
in the tables. The disturbances of the ABB benchmark are files that are not published with its parameters, so only its
frequencies are computed here, and no score.

Quanser's rotary flexible joint (`fm.catalog.rotary_joint`) is the arm of a benchmark of safety filters, a command
governor and a control barrier function (Liao, Breschi and Nicotra, *Experimental Demonstration and Benchmarking of
Data-Driven Safety Filters*, with programs under the MIT licence). Its text says that motor angle, spring deflection,
both rates and the input are limited, and that a solve takes about 2 ms. The values of the limits are in binary files;
the axes of its plots end at 3 s, 1.1 rad, 0.15 rad, 6 rad/s and an input of 7. `docs/examples/rotary_joint.yaml` is an
environment with limits within these axes: 1 rad, 0.1 rad (as a torque of the spring) and 5 rad/s, at 10 V. In 87 of 100
slews an LQR exceeds these limits, by a factor of up to 3.2; with the [safety filter](../safety.md) in none, and the
median settling time is 0.95 s in place of 0.94 s. The filter takes 0.7 ms an action, at a control period of 2 ms.

## Printed and measured results

{printed} of {of_printed} results are met, printed ones within 2 % or their last digit, measured ones of the rotary link
within 4 %, the grid of the measurement.

{first}

{reasons}

The response that was measured at Kyoto University has no licence, so it is not part of this package. `flexman verify
papers --data FILE` reads a response of your own, a CSV file of at least 12 frequencies whose first line is
`frequency (Hz),real (rad/V),imaginary (rad/V)`, for the hub angle as response to the voltage. It fits stiffness,
inertia, friction, damping and the torque per volt to every second frequency, and prints the error at the others.

The same command fits the axis of Wernholt and Gunnarsson, whose records come with a commercial toolbox, to a file of
yours: a response of the motor rate to the torque, with the columns `frequency (Hz),real (rad/s/(N m)),imaginary
(rad/s/(N m))`, or a record with `time (s),motor torque (N m),motor rate (rad/s)`, from which the response is estimated
where the coherence is above 0.9. Inertias, springs, dampers and viscous friction are fitted; the model is linear, so
that Coulomb friction appears as viscous friction.

The arm of Rome moves from rest to rest by the torque of the flat output of its linear model. The angles that its
authors print follow from their modal data, whose mass matrix has the inertia of rotor and hub alone; with the modes of
this package the tip stays nearer to the flat output. The linear model has no centrifugal forces: after a simulated move
of 90 degrees in 2 s the tip is up to 4.5 mm from its goal, after 4 s 0.3 mm, and 24 mm after 2 s without foreshortening
(`stiffening`). `HeldModes` in `flexman_gym.toolbox.verification.flat_output` computes the torque.

## Frequencies computed by other programs

The expected values are computed from the printed parameters by planar beam elements of another program, or from the
matrices of a chain of masses. {computed} of {of_computed} agree within 0.5 %, chains of masses within 0.1 %.

{second}

{more}
"""

MASSES = """# Two masses and a spring

`FlexTwoMass-v0` is the benchmark of Wie and Bernstein: two masses of 1 on a spring between 0.5 and 2, a torque of at
most 1 on mass 1, and the position of mass 2 as the only measurement. Stengel and Marrison (1992) compare controllers by
such probabilities; their article was not available, and the definitions are our own. Each number is a share of 1,000
random springs, uniform in the range:

- unstable: an eigenvalue of the sampled closed loop is not inside the unit circle;
- slow: unstable, or mass 2 is beyond 0.1 later than 15 s after a unit impulse on it;
- saturated: the torque exceeds 1 after this impulse. The loop is linear, so that torques are not limited.

The last two columns are for the nominal spring. The agents are designed for the nominal spring, or for the whole range
(the condition `stiffness`). Their default cost weights need more than the torque of the benchmark; weights of 3 m,
2 m/s and 3 rad, set by hand on springs of another seed, need less with the nominal spring. The Kalman filter of the LQG
has its stationary gain (`fixed`).

{masses}

The H-infinity controller that is designed for the range with these weights has the smallest shares. To choose it:

```python
import flexman_gym as fm

agent = {{"kind": "hinf", "weights": {{"tip": 3.0, "tip_speed": 2.0, "motor": 3.0}}}}
result = fm.evaluate(agent, "FlexTwoMass-v0/stiffness", range(3))
```
"""


def masses_page(masses: Sequence[TwoMassRow]) -> str:
    """Return the page of the benchmark of two masses as Markdown."""
    return MASSES.format(masses=two_mass_table(masses))


def page(printed: Sequence[VerificationRow], computed: Sequence[VerificationRow]) -> str:
    """Return the page as Markdown."""
    return PAGE.format(
        printed=_passed(printed), of_printed=sum(row.verdict != SHOWN for row in printed), first=_table(printed),
        reasons=_reasons(printed), computed=_passed(computed), of_computed=len(computed), second=_table(computed),
        more=_reasons(computed),
    )  # fmt: skip


def _passed(rows: Sequence[VerificationRow]) -> int:
    return sum(row.verdict == PASS for row in rows)


def _table(rows: Sequence[VerificationRow]) -> str:
    numbers = [(f"{row.expected:.4g}", f"{row.computed:.4g}", f"{100 * row.error:.2g}") for row in rows]
    cells = [(row.source.partition(";")[0], row.case, *each) for row, each in zip(rows, numbers, strict=True)]
    return "\n".join(markdown_table(("source", "quantity", "expected", "this package", "difference, %"), cells))


def _reasons(rows: Sequence[VerificationRow]) -> str:
    """Return the reasons for the differences beyond the tolerance, as a list."""
    return "\n".join(f"- {row.case}: {REASONS[row.case]}" for row in rows if row.verdict != PASS)
