#!/bin/sh
# Builds the wheels of a release into a new folder: one for every platform, and, for each Python, one with the machine
# code of the kernels for the processors of this machine's kind. Then it tries them in empty environments.
#
#     scripts/wheels.sh FOLDER [PYTHON ...]
#
# The Pythons are programs (default: those named python3.11, python3.12, python3.13 that are found). On another kind of
# machine the same command builds the wheel of that kind; for processors other than x86-64 kernels compile.
set -eu

checkout=$(cd "$(dirname "$0")/.." && pwd)
[ $# -gt 0 ] || { echo "usage: scripts/wheels.sh FOLDER [PYTHON ...]" >&2; exit 2; }
mkdir "$1"
folder=$(cd "$1" && pwd)
shift
unset PYTHONPATH PYTHONHOME
if [ $# -eq 0 ]; then
    for version in 3.11 3.12 3.13; do
        if command -v "python$version" >/dev/null && "python$version" -c ""; then
            set -- "$@" "python$version"
        else
            echo "No python$version: its wheel is left out; build it where there is one with: scripts/wheels.sh FOLDER python$version"
        fi
    done
fi
