"""Naming: an arm by its name in the catalog, by a file or by a mapping."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from flexman_gym.checks import one_of, refusal, shown_path, text
from flexman_gym.scene import arms, file, machines
from flexman_gym.scene.arm import Arm, Payload
from flexman_gym.scene.plain import arm_of, part_of

ARMS: dict[str, Callable[..., Arm]] = {  # of the catalog
    "paper_rrr": arms.paper_rrr,
    "planar_2r": arms.planar_2r,
    "one_link": arms.one_link,
    "vertical_2r": arms.vertical_2r,
    "one_joint": arms.one_joint,
    "quanser_2dsfl": machines.quanser_2dsfl,
    "flexarm_rome": machines.flexarm_rome,
    "de_luca_siciliano": machines.de_luca_siciliano,
    "gifu_2link": machines.gifu_2link,
    "nasa_beam": machines.nasa_beam,
}
SUFFIXES = (".json", ".yaml", ".yml")
ArmLike = Arm | Mapping[str, Any] | str


def find_arm(value: object, folder: Path = Path()) -> Arm:
    """Gives an Arm, or the arm that something else stands for.

    Args:
        value: an Arm; the name of an arm of the catalog; a mapping with that name at "catalog" and its arguments; the
            path of a file with an arm or a scene; or a mapping as in such a file.
        folder: against which a path is meant.

    Raises:
        FileNotFoundError: for a file that does not exist.
        ValueError: for anything else; one line with field, value and what is allowed.
    """
    if isinstance(value, Arm):
        return value
    if not isinstance(value, str | dict):
        raise refusal("arm", value, f"an Arm, a mapping, a file, or a name in the catalog: {', '.join(ARMS)}")
    if isinstance(value, str) and value.endswith(SUFFIXES):
        try:
            data = file.read(folder / value)
        except ValueError as error:
            raise ValueError(f"{shown_path(value)}: {error}") from None
        return arm_of(data if "links" in data else data.get("arm", data))
    if isinstance(value, dict) and "catalog" not in value:
        return arm_of(value)
    given = {"catalog": value} if isinstance(value, str) else value
    arguments = {text("a key of arm", name): each for name, each in given.items() if name != "catalog"}
    name = one_of("arm", given["catalog"], ARMS)
    if isinstance(arguments.get("payload"), dict):
        arguments["payload"] = part_of(Payload, "arm.payload", arguments["payload"])
    try:
        arm = ARMS[name](**arguments)
    except TypeError as error:
        raise refusal("arm", arguments, f"what {name} takes: {str(error).split('() ')[-1]}") from None
    return arm
