#!/bin/sh
# Builds the wheels of a release into a new folder: one for every platform, in which kernels compile, and, for each
# Python, one with the machine code of the kernels for processors of the kind of this machine. Those with machine code
# are installed in empty environments and used there without a compilation.
#
#     scripts/wheels.sh FOLDER [PYTHON ...]
#
# It stops if numbers of README and home are of rows that are older than their code, unless TRIAL=1 is set: such wheels
# are not released.
#
# The Pythons are programs (default: those of 3.11, 3.12, 3.13 that are found, of pyenv too).
set -eu

checkout=$(cd "$(dirname "$0")/.." && pwd)
[ $# -gt 0 ] || { echo "usage: scripts/wheels.sh FOLDER [PYTHON ...]" >&2; exit 2; }
if [ -z "${TRIAL:-}" ] && ! (cd "$checkout" && .venv/bin/python -m studies evidence --release); then
    echo "make evidence STUDY=NAME computes rows again; TRIAL=1 builds wheels that are not released" >&2
    exit 1
fi
mkdir "$1"
folder=$(cd "$1" && pwd)
shift
unset PYTHONPATH PYTHONHOME

if [ $# -eq 0 ]; then
    for version in 3.11 3.12 3.13; do
        for python in "python$version" "$HOME"/.pyenv/versions/"$version".*/bin/python; do
            if "$python" -c "" 2>/dev/null; then
                set -- "$@" "$python"
                continue 2
            fi
        done
        echo "No Python $version here: for its wheel run scripts/wheels.sh FOLDER PYTHON with one"
    done
fi
[ $# -gt 0 ] || { echo "no Python of 3.11, 3.12, 3.13 is found; name one" >&2; exit 1; }
machine=$(uname -m)
case "$(uname -s)" in
    Linux) platform=manylinux_2_28_$machine ;;
    *) platform=macosx_11_0_$machine ;;
esac
echo "Wheels of other machines (64-bit ARM, macOS) need the same command there: scripts/wheels.sh FOLDER"

"$1" -m venv "$folder/tools"
"$folder/tools/bin/python" -m pip install --quiet "setuptools>=77" wheel
rm -rf "$checkout"/build/lib "$checkout"/build/bdist.* # files that are gone would be built in again
(cd "$checkout" && "$folder/tools/bin/python" -c "from setuptools import build_meta; build_meta.build_sdist('$folder')" >/dev/null)
"$folder/tools/bin/python" -m pip wheel --quiet --no-deps --wheel-dir "$folder" "$folder"/*.tar.gz
pure=$(echo "$folder"/*-py3-none-any.whl)

for python; do
    tag=$("$python" -c "import sys; print('cp%d%d' % sys.version_info[:2])")
    echo "$tag: compiling the kernels"
    build=$folder/build-$tag
    mkdir "$build"
    "$python" -m venv "$build/environment"
    "$build/environment/bin/python" -m pip install --quiet "$pure"
    (cd "$build" && environment/bin/python "$checkout/scripts/machine_code.py" code "$checkout/scripts/kernel_uses.py")
    "$folder/tools/bin/python" -m wheel unpack --dest "$build" "$pure" >/dev/null
    unpacked=$(echo "$build"/flexman_gym-*)
    mv "$build/code" "$unpacked/flexman_gym/kernels/machine_code"
    "$folder/tools/bin/python" -m wheel pack --dest-dir "$build" "$unpacked" >/dev/null
    name=$("$folder/tools/bin/python" -m wheel tags --remove --python-tag "$tag" --platform-tag "$platform" "$build"/*.whl)
    mv "$build/$name" "$folder"

    echo "$tag: using $name"
    "$python" -m venv "$build/trial"
    "$build/trial/bin/python" -m pip install --quiet "${TORCH:-torch}"
    "$build/trial/bin/python" -m pip install --quiet "$folder/$name[train]"
    mkdir "$build/work"
    (cd "$build/work" && XDG_CACHE_HOME="$build/cache" ../trial/bin/python "$checkout/scripts/wheel_trial.py" --silent "$checkout/README.md")
    (cd "$build/work" && XDG_CACHE_HOME="$build/cache" ../trial/bin/flexman check)
    rm -r "$build"
done
rm -r "$folder/tools"
ls -l "$folder"
