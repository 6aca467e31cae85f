#!/bin/sh
# The weights `kitti`: `large`, fine-tuned on KITTI 2015 and, so that it forgets nothing, on rendered pairs; about 40
# minutes on one core. The pairs that val.txt names are left out.
#
#     recipes/kitti.sh FOLDER KITTI
#
# KITTI is the folder of training/ and val.txt; it may also be in the environment. The pairs, the run and the weights go
# to FOLDER. Interrupted and started again, it goes on where it was. With PAIRS and STEPS in the environment it is shorter.
set -e
out=${1:?expected a folder for the pairs and the run}
kitti=${2:-${KITTI:?expected the folder of KITTI 2015}}
anynet render --out "$out/pairs" --count "${PAIRS:-112}" --seed 700000
# Eight times each, 28 pairs are two thirds of the crops.
set -- --data "rendered:$out/pairs"
for _ in 1 2 3 4 5 6 7 8; do set -- "$@" --data "kitti2015:$kitti?without=$kitti/val.txt"; done
# Real rigs need many steps at a rate of 1e-3 (1,000 at 5e-4 brought `large` half of the way), and stage 1, which no later
# one mends, a weight of 1. The average over the last steps evens out the statistics of batches of 3.
anynet finetune --preset kitti --weights "${LARGE:-large}" --steps "${STEPS:-1500}" --seed 12 --perturb \
    --learning-rate 1e-3 --far-weight 0.2 --ema-decay 0.99 \
    --stage-weights 1 --stage-weights 0.5 --stage-weights 1 --stage-weights 1 \
    "$@" --out "$out/kitti" --resume
