#!/bin/sh
# The last run of the weights `large`, which taught them real rigs; about half an hour on two cores. The runs before it
# are in docs/weights.md.
#
#     recipes/large.sh FOLDER
#
# The pairs, the run and the weights go there. Interrupted and started again, it goes on where it was.
# With PAIRS and STEPS in the environment it is shorter.
set -e
out=${1:?expected a folder for the pairs and runs}
anynet render --out "$out/first" --count "${PAIRS:-800}" --seed 500000
anynet render --out "$out/second" --count "${PAIRS:-400}" --seed 500800
anynet finetune --preset enlarged --weights "${LARGE:-large}" --steps "${STEPS:-1000}" --seed 11 --perturb \
    --learning-rate 5e-4 --far-weight 0.2 --occluded-weight 0.5 \
    --stage-weights 1 --stage-weights 0.5 --stage-weights 1 --stage-weights 1 \
    --data "rendered:$out/first" --data "rendered:$out/second" --out "$out/large" --resume
