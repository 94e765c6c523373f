"""Small URDF files: links with given inertias, and joints between them."""

BODY = 'ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"'


def link(name, mass=1.0, inertia=BODY, rest=""):
    """Return the element of a link with its centre of mass at a height of 0.15 m; `inertia` has the attributes."""
    return (f'<link name="{name}"><inertial><origin xyz="0 0 0.15"/><mass value="{mass}"/><inertia {inertia}/>'
            f"</inertial>{rest}</link>")  # fmt: skip


def joint(name, parent, child, kind="revolute", rest='<axis xyz="0 1 0"/>'):
    """Return the element of a joint at a height of 0.3 m in its parent link."""
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.3"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{rest}</joint>'


def robot(*elements, inner=""):
    """Return a URDF of a base, two links that turn about z and y, and further elements; `inner` is within link b."""
    first = joint("j1", "base", "a", rest='<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="40" velocity="3"/>')
    parts = ['<link name="base"/>', link("a"), link("b", rest=inner), first, joint("j2", "a", "b")]
    return "\n".join(['<robot name="made_up">', *parts, *elements, "</robot>"])
