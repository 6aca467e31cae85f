#!/bin/sh
# The last run of the weights `large`, longer than any before it, with the faults of real rigs. Ten minutes on an H100, about
# a day on two cores. The runs before it are in docs/weights.md.
#
#     recipes/large.sh FOLDER
#
# The pairs, the run and the weights go there. Interrupted and started again, it goes on where it was.
# With PAIRS and STEPS in the environment it is shorter.
set -e
out=${1:?expected a folder for the pairs and the run}
anynet render --out "$out/pairs" --count "${PAIRS:-2400}" --seed 2000000
anynet finetune --preset enlarged --weights "${LARGE:-large}" --steps "${STEPS:-13871}" --seed 41 --perturb \
    --learning-rate 1e-3 --warmup-steps 100 --batch-size 8 --crop-size 256 512 --ema-decay 0.995 \
    --far-weight 0.2 --occluded-weight 0.5 --smooth-below 0.25 \
    --stage-weights 1 --stage-weights 0.5 --stage-weights 1 --stage-weights 1 \
    --data "rendered:$out/pairs" --out "$out/large" --resume
