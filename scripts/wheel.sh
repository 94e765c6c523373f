#!/bin/sh
# Tries the wheel as somebody has it who knows no checkout: built from the source archive, installed into an empty
# environment, used in an empty folder. Everything goes to a temporary folder that is removed, or to a new one that is named, which is kept.
set -eu

checkout=$(cd "$(dirname "$0")/.." && pwd)
if [ $# -gt 0 ]; then
    mkdir "$1"
    folder=$(cd "$1" && pwd)
else
    folder=$(mktemp -d)
    trap 'rm -rf "$folder"' EXIT
fi
unset PYTHONPATH PYTHONHOME

echo "Building the wheel and installing it in $folder"
rm -rf "$checkout"/build/lib "$checkout"/build/bdist.* # files that are gone would be built in again
"${PYTHON:-python3}" -m venv "$folder/environment"
export PATH="$folder/environment/bin:$PATH"
mkdir "$folder/work"
cd "$folder/work"
python -m pip install --quiet "setuptools>=77"
(cd "$checkout" && python -c "from setuptools import build_meta; build_meta.build_sdist('$folder/source')" >/dev/null)
python -m pip wheel --quiet --no-deps --wheel-dir "$folder/wheel" "$folder"/source/*.tar.gz
python -m pip install --quiet "${TORCH:-torch}"
python -m pip install --quiet "$(echo "$folder"/wheel/*.whl)[train]"

export XDG_CACHE_HOME="$folder/cache" # kernels compile as they do for the first time
for command in check list "train ppo_on_pd_minute --steps 2000 --quiet --folder runs/first" "evaluate runs/first pd"; do
    echo "flexman $command"
    flexman $command # its words are arguments
done
echo "The wheel works."
