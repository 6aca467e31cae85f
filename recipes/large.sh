#!/bin/sh
# The last two runs of the weights `large`, which taught them real rigs: two and a half hours on two cores, or five minutes
# on an H100. The weights are the mean of both: nearly as exact on good pairs as the first, and less upset by bad ones. The
# runs before are in docs/weights.md.
#
#     recipes/large.sh FOLDER
#
# The pairs, the runs and the weights go there. Interrupted and started again, it goes on where it was.
# With PAIRS and STEPS in the environment it is shorter.
set -e
out=${1:?expected a folder for the pairs and runs}
here=$(dirname "$0")
rigs="--perturb --far-weight 0.2 --occluded-weight 0.5"
rigs="$rigs --stage-weights 1 --stage-weights 0.5 --stage-weights 1 --stage-weights 1"
anynet render --out "$out/first" --count "${PAIRS:-800}" --seed 500000
anynet render --out "$out/second" --count "${PAIRS:-400}" --seed 500800
anynet finetune --preset enlarged --weights "${LARGE:-large}" --steps "${STEPS:-1000}" --seed 11 $rigs \
    --learning-rate 5e-4 --data "rendered:$out/first" --data "rendered:$out/second" --out "$out/large-first" --resume
# Larger crops, twice as many, at a higher rate.
anynet render --out "$out/third" --count "${PAIRS:-1000}" --seed 900000
anynet finetune --preset enlarged --weights "$out/large-first/weights.safetensors" --steps "${STEPS:-1951}" --seed 21 $rigs \
    --learning-rate 1e-3 --batch-size 6 --crop-size 256 512 --robust-scale 0 --ema-decay 0.995 \
    --data "rendered:$out/third" --out "$out/large-second" --resume
mkdir -p "$out/large"
"${PYTHON:-python}" "$here/average.py" "$out/large/weights.safetensors" \
    "$out/large-first/weights.safetensors" "$out/large-second/weights.safetensors"
