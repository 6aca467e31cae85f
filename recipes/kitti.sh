#!/bin/sh
# The weights `kitti`: a mean of two that `large` became on KITTI 2015; about 90 minutes on one core, one on an H100. The
# pairs that val.txt names are left out.
#
#     recipes/kitti.sh FOLDER KITTI
#
# KITTI is the folder of training/ and val.txt; it may also be in the environment. The pairs, the runs and the weights go
# to FOLDER. Interrupted and started again, it goes on where it was. With PAIRS and STEPS in the environment it is shorter.
set -e
out=${1:?expected a folder for the pairs and the runs}
kitti=${2:-${KITTI:?expected the folder of KITTI 2015}}
here=$(dirname "$0")
real="kitti2015:$kitti?without=$kitti/val.txt"
# One on these pairs alone, as they are: the most exact on pairs that are as good.
anynet finetune --preset kitti --weights "${LARGE:-large}" --steps "${STEPS:-700}" --seed 14 \
    --smooth-below 0.25 --data "$real" --out "$out/kitti-alone" --resume
# One with the faults of rigs, and on rendered pairs, so that it forgets nothing. Eight times each, the 28 real pairs are
# two thirds of the crops. Rigs need many steps at a rate of 1e-3, and stage 1, which no later one mends, a weight of 1.
anynet render --out "$out/pairs" --count "${PAIRS:-112}" --seed 700000
set -- --data "rendered:$out/pairs"
for _ in 1 2 3 4 5 6 7 8; do set -- "$@" --data "$real"; done
anynet finetune --preset kitti --weights "${LARGE:-large}" --steps "${STEPS:-2500}" --seed 12 --perturb \
    --learning-rate 1e-3 --far-weight 0.2 --ema-decay 0.99 --smooth-below 0.25 \
    --stage-weights 1 --stage-weights 0.5 --stage-weights 1 --stage-weights 1 \
    "$@" --out "$out/kitti-rigs" --resume
# The second one counts twice, or pairs that are turned would have more than twice the errors.
mkdir -p "$out/kitti"
"${PYTHON:-python}" "$here/average.py" "$out/kitti/weights.safetensors" \
    "$out/kitti-alone/weights.safetensors" \
    "$out/kitti-rigs/weights.safetensors" "$out/kitti-rigs/weights.safetensors"
