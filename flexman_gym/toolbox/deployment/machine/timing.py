"""Tests of the transport of readings: their age, the period and the clock of the machine, and lost packets."""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from flexman_gym.toolbox.deployment.machine.machine import Receipt
from flexman_gym.toolbox.deployment.machine.packets import COPIES

MAX_AGE = 2.0  # control periods; age of readings at a deadline beyond which they are late
SPAN = 5  # control periods in which a wrong period or clock is noticed
LONG = 1.5  # control periods between two samples of a machine that is slow; 1 / LONG of one that is fast
SLOW, FAST = 2, 3  # readings in a row with such a period; a machine that was held up once catches up
MAX_DRIFT = 2.0  # control periods in SPAN readings by which the clocks of loop and machine may diverge
DRIFTS = 2  # readings in a row with such a difference
FEWEST = 1 / 3  # share of the packets below which a connection is not fit for control
HEARD = 3  # control periods, of which one has new readings, of a machine that is not silent
FEW = 5  # control periods for each new readings beyond which a connection without receipts is not fit for control


class TimingTest:
    """Tests of the transport of the readings of a machine.

    The age of readings follows from the packet that the machine had received last when it sampled them: from its time,
    and from the time that it dwelt in the machine. The clocks of loop and machine need not agree. A packet that travels
    late in either direction makes the readings older.

    Args:
        period: control period, s.
        silence: control periods in which a lost connection is noticed.
    """

    def __init__(self, period: float, silence: int) -> None:
        self._period, self._silence = period, silence
        self.begin(None)

    def begin(self, receipt: Receipt | None) -> None:
        """Begin the tests at the first deadline; `receipt` is that of the newest readings, None without one."""
        self._receipt = receipt
        self._late, self._slow, self._fast, self._drifts = 0, 0, 0, 0
        first = [] if receipt is None else [receipt]
        self._receipts = deque(first, SPAN + 1)
        self._arrived = deque((each.arrived for each in first), self._silence + 1)  # packets so far at the deadlines
        self._fresh: deque[bool] = deque(maxlen=self._silence)  # deadlines with new readings

    def start(self, receipts: Sequence[tuple[Receipt, float]]) -> str:
        """Return what is wrong with the readings before the first command; "" if nothing is.

        Args:
            receipts: receipts of successive readings, and the times at which they were read, s.
        """
        if not receipts:
            return ""
        age = min(now - each.sampled for each, now in receipts) / self._period
        if not np.isfinite(age):
            return "readings that do not echo the sequence numbers of the packets of the loop"
        if not -1.0 <= age <= MAX_AGE:
            return f"readings that are {1e3 * age * self._period:.3g} ms old"
        steps = [(new.time - old.time) / (new.number - old.number) for (old, _), (new, _) in pairwise(receipts)]
        ratio = float(np.median(steps)) / self._period
        if not 1.0 / LONG < ratio < LONG:
            return f"readings every {1e3 * ratio * self._period:.3g} ms"
        return ""

    def check(self, receipt: Receipt | None, fresh: bool, now: float) -> str:
        """Return what is wrong at a deadline; "" if nothing is.

        Args:
            receipt: transport of the newest readings; None for a machine that does not tell it.
            fresh: True if they have arrived since the last deadline.
            now: time of the deadline, s.
        """
        self._fresh.append(fresh)
        if receipt is None or self._receipt is None:
            few = fresh and len(self._fresh) == self._silence and FEW * sum(self._fresh) <= self._silence
            return f"new readings in {sum(self._fresh)} of {self._silence} control periods only" if few else ""
        return self._age(receipt, now) or self._clock(receipt, fresh) or self._losses(receipt)

    def _age(self, receipt: Receipt, now: float) -> str:
        """Return a text if the readings are old for several deadlines."""
        age = (now - receipt.sampled) / self._period
        self._late = 0 if age <= MAX_AGE else self._late + 1
        if self._late >= max(self._silence - 2, 1) and self._fresh[-1]:
            return f"readings are {1e3 * age * self._period:.3g} ms old, {age:.2g} control periods"
        return ""

    def _clock(self, receipt: Receipt, fresh: bool) -> str:
        """Return a text if the time stamps of the machine advance by other steps than its period or the time."""
        if not fresh:
            return ""
        last, self._receipt = self._receipt, receipt
        assert last is not None
        self._receipts.append(receipt)
        first = self._receipts[0]
        step = (receipt.time - last.time) / (receipt.number - last.number) / self._period
        drift = ((receipt.time - first.time) - (receipt.sampled - first.sampled)) / self._period
        self._drifts = 0 if abs(drift) <= MAX_DRIFT else self._drifts + 1
        self._slow = self._slow + 1 if step > LONG else 0
        self._fast = self._fast + 1 if step < 1.0 / LONG else 0
        if self._slow >= SLOW or self._fast >= FAST:
            return (
                f"the machine stamps a sample every {1e3 * step * self._period:.3g} ms, not {1e3 * self._period:g} ms"
            )
        if self._drifts >= DRIFTS:
            count = len(self._receipts) - 1
            return f"the clock of the machine is wrong by {1e3 * drift * self._period:.3g} ms in {count} readings"
        return ""

    def _losses(self, receipt: Receipt) -> str:
        """Return a text if too few packets arrive."""
        self._arrived.append(receipt.arrived)
        expected, arrived = COPIES * (len(self._arrived) - 1), self._arrived[-1] - self._arrived[0]
        heard = any(list(self._fresh)[-HEARD:])  # a machine that is silent is another fault
        if heard and len(self._arrived) > self._silence and arrived <= FEWEST * expected:
            return f"{expected - arrived} of {expected} packets are lost"
        return ""
