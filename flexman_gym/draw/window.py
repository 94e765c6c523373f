"""Window: frames on a screen, by pygame."""

import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray


def has_display() -> bool:
    """Whether a window could be opened: there is pygame and, on Linux, a display."""
    from importlib.util import find_spec

    shown = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"))
    return find_spec("pygame") is not None and (shown or not sys.platform.startswith("linux"))


class Window:
    """A window that shows frames at their pace.

    Attributes:
        shown, late: frames that were shown, and those of them that came later than the clock wanted.
    """

    def __init__(self, size: tuple[int, int], title: str, period: float) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        import pygame

        self._pygame: Any = pygame
        pygame.display.init()
        pygame.display.set_caption(title)
        self._screen, self._clock = pygame.display.set_mode(size), pygame.time.Clock()
        self._period, self.shown, self.late = period, 0, 0

    def show(self, picture: NDArray[np.uint8]) -> None:
        """Shows a picture (height, width, 3), and waits until it is time for the next."""
        surface = self._pygame.surfarray.make_surface(picture.swapaxes(0, 1))
        self._screen.blit(surface, (0, 0))
        self._pygame.event.pump()
        self._pygame.display.flip()
        self.shown += 1
        taken = self._clock.tick(1.0 / self._period)
        self.late += bool(self.shown > 1 and taken > 1500.0 * self._period)

    def close(self) -> None:
        """Closes it."""
        self._pygame.display.quit()
        if self.late:
            print(f"{self.late} of {self.shown} frames came late", file=sys.stderr)
