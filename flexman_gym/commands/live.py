"""Show an arm in real time on a web page, with controls."""

import argparse
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from flexman_gym.commands import CommandLine, add_options


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    parser.add_argument("environment", nargs="?", help="environment: an id, an id with a condition, or a file "
                        "(default: that of the agent)")  # fmt: skip
    add_options(parser, "--seed", "--trust", seed={"help": "seed of the first episode (default: %(default)s)"})
    parser.add_argument("--agent", action="append", metavar="NAME", help="agent, as in flexman evaluate; twice for two "
                        "agents side by side (default: pd)")  # fmt: skip
    parser.add_argument("--port", type=int, default=0, help="port of the page (default: a free one)")


def _run(options: argparse.Namespace) -> int:
    """Show the page until Ctrl+C; return 0, or 1 if the simulation ends by itself."""
    from flexman_gym.commands import load_agent
    from flexman_gym.envs.config.configuration import Configuration
    from flexman_gym.envs.config.named_environments import DEFAULT_ID
    from flexman_gym.toolbox.view.live_session import live

    named = Configuration.find(options.environment) if options.environment else None
    names = options.agent or ["pd"]
    loaded = {name: replace(load_agent(name, options.trust, named), name=name) for name in names}
    agents = [loaded[name] for name in names]
    trained = next((agent.environment.id for agent in agents if agent.environment), DEFAULT_ID)
    with (
        _interrupts() as interrupts,
        suppress(KeyboardInterrupt),
        live(options.environment or trained, agents, options.seed, options.port) as session,
    ):
        try:
            if not interrupts:
                session.wait()
        except RuntimeError as error:  # such as an agent that exits
            print(error, file=sys.stderr)
            return 1
    return 0


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Context manager with a list of the received interrupts (Ctrl+C), each of which raises KeyboardInterrupt.

    Python drops an exception that is raised in a callback of C code, such as those of LLVM that load kernels.
    """
    received: list[int] = []

    def receive(number: int, _: object) -> None:
        received.append(number)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, receive)
    try:
        yield received
    finally:
        signal.signal(signal.SIGINT, before)


EXAMPLES = (
    "flexman live FlexRRR-v0  # with the PD controller",
    "flexman live FlexOne-v0 --agent pd --agent lqr-tracking",
)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
