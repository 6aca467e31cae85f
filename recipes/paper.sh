#!/bin/sh
# Weights of the paper's network from scratch, as `paper`; two to three hours on two cores, half an hour of it rendering.
# The packaged `paper` came from the longer chain of runs in docs/weights.md, not from this recipe, which repeats that
# chain's kinds of steps on one set of pairs. Its full length has not been run yet.
#
#     recipes/paper.sh FOLDER
#
# The pairs, the runs and the weights go there. Interrupted and started again, it goes on where it was.
# With PAIRS and STEPS in the environment it is shorter.
set -e
out=${1:?expected a folder for the pairs and runs}
anynet render --out "$out/pairs" --count "${PAIRS:-3000}" --seed 800000
# From random weights, with every pixel and error counting in full.
anynet train --preset paper --steps "${STEPS:-8000}" --data "rendered:$out/pairs" --out "$out/paper-first" --resume
# Then twice with less weight on what cannot be matched, each from the weights before and with a cosine of its own.
robust="--learning-rate 1.5e-3 --robust-scale 3 --far-weight 0.1 --occluded-weight 0.2"
anynet finetune --preset paper --weights "$out/paper-first/weights.safetensors" --steps "${STEPS:-6000}" --seed 1 $robust \
    --data "rendered:$out/pairs" --out "$out/paper-second" --resume
anynet finetune --preset paper --weights "$out/paper-second/weights.safetensors" --steps "${STEPS:-6000}" --seed 2 $robust \
    --data "rendered:$out/pairs" --out "$out/paper" --resume
