#!/bin/sh
# The weights `paper`, of the paper's network, from scratch; about three hours on two cores, one of them rendering. The
# first two runs were ten minutes on an H100.
#
#     recipes/paper.sh FOLDER
#
# The pairs, the runs and the weights go there. Interrupted and started again, it goes on where it was.
# With PAIRS and STEPS in the environment it is shorter.
set -e
out=${1:?expected a folder for the pairs and runs}
anynet render --out "$out/first" --count "${PAIRS:-800}" --seed 500000
anynet render --out "$out/second" --count "${PAIRS:-400}" --seed 500800
anynet render --out "$out/more" --count "${PAIRS:-1000}" --seed 900000
anynet render --out "$out/most" --count "${PAIRS:-2400}" --seed 1000000
# From random weights, with every pixel and error counting in full.
anynet train --preset paper --steps "${STEPS:-4809}" --batch-size 12 --learning-rate 2.5e-3 --seed 33 \
    --data "rendered:$out/most" --out "$out/paper-first" --resume
# Then with the faults of real rigs and less weight on what cannot be matched, each from the weights before and with a
# cosine of its own.
rigs="--batch-size 12 --perturb --robust-scale 3 --far-weight 0.1 --occluded-weight 0.2"
anynet finetune --preset paper --weights "$out/paper-first/weights.safetensors" --steps "${STEPS:-8479}" --seed 34 $rigs \
    --learning-rate 2e-3 --ema-decay 0.995 --data "rendered:$out/most" --out "$out/paper-second" --resume
anynet finetune --preset paper --weights "$out/paper-second/weights.safetensors" --steps "${STEPS:-4200}" --seed 35 $rigs \
    --learning-rate 1.5e-3 --stage-weights 1 --stage-weights 0.5 --stage-weights 1 --stage-weights 1 \
    --data "rendered:$out/first" --data "rendered:$out/second" --data "rendered:$out/more" --out "$out/paper" --resume
