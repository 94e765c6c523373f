#!/bin/sh
# Trains a policy with each of several libraries, written as in the documentation of the library, in an environment of
# packages of its own, .cache/clients; prints the mean returns before and after, and fails if one does not increase.
set -eu

checkout=$(cd "$(dirname "$0")/.." && pwd)
environment="$checkout/.cache/clients"
if [ ! -f "$environment/installed" ]; then
    echo "Installing the libraries into $environment: once, for some minutes"
    "${PYTHON:-python3}" -m venv "$environment"
    "$environment/bin/python" -m pip install --quiet "${TORCH:-torch}"
    # the high-level interface of Tianshou needs its extra eval
    "$environment/bin/python" -m pip install --quiet -e "$checkout" "stable-baselines3>=2.9,<3" sb3-contrib skrl torchrl "tianshou[eval]"
    touch "$environment/installed"
fi
export OMP_NUM_THREADS=1 PYTHONWARNINGS=ignore
for client in sb3 contrib skrl torchrl tianshou; do
    "$environment/bin/python" "$checkout/scripts/clients/train_$client.py"
done
