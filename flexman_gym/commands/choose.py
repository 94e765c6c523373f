"""Choose the smallest model and longest step that meet a tolerance."""

import argparse
import sys

from flexman_gym.commands import CommandLine, add_options, load_scene


def _arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line arguments."""
    add_options(parser, "scene")
    parser.add_argument(
        "--tolerance", type=float, metavar="M", default=1e-3, help="largest error of the tip, m (default: %(default)s)"
    )


def _run(options: argparse.Namespace) -> int:
    """Print the chosen method and model, the estimated error, and the omitted parts of the model; return 0."""
    from flexman_gym.simulation.diagnostics import explain_bending
    from flexman_gym.simulation.scene_simulation import simulate
    from flexman_gym.toolbox.fidelity.model_selection import choose_model

    scene = load_scene(options.scene)
    choice = choose_model(scene, options.tolerance)
    step = "variable steps" if choice.step is None else f"steps of {1e3 * choice.step:.4g} ms"
    print(f"method: {getattr(choice.method, 'name', choice.method)}, {step}")
    made = choice.model.choice
    print(f"model: elements={made.elements}, modes={made.modes}, stiffening={made.stiffening}")
    print(f"coordinates: {choice.model.n_dof}")
    print(f"estimated error of the tip: {1e3 * choice.estimated_error:.3g} mm, compared with the whole model")
    for name in choice.dropped:
        print(f"left out: {name}")
    if bending := explain_bending(choice.model, simulate(scene, choice.model, choice.method, choice.step).states):
        print(f"! {bending}", file=sys.stderr)
    return 0


EXAMPLES = ("flexman choose paper_ff --tolerance 0.01  # 1 cm",)
COMMAND = CommandLine(_arguments, _run, EXAMPLES)
