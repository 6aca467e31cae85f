#!/bin/sh
# The weights `default`: features and later stages of `large`, a first stage of its own; most of a day on two cores. The
# last two of the six runs were ten minutes each on an H100.
#
#     recipes/default.sh FOLDER
#
# The pairs, the runs and the weights go there. Interrupted and started again, it goes on where it was.
# With PAIRS and STEPS in the environment it is shorter.
set -e
out=${1:?expected a folder for the pairs and runs}
anynet render --out "$out/first" --count "${PAIRS:-800}" --seed 500000
anynet render --out "$out/second" --count "${PAIRS:-400}" --seed 500800
anynet render --out "$out/third" --count "${PAIRS:-3200}" --seed 501200
# The new first stage alone, on features that already know how to compare.
anynet finetune --preset default --weights large --load-partial --steps "${STEPS:-4000}" --seed 1 \
    --learning-rate 1.5e-3 --stage-weights 1 --stage-weights 0 --stage-weights 0 --stage-weights 0 \
    --data "rendered:$out/first" --out "$out/default-first-stage" --resume
# Then all of it, five times, each from the weights before and with a cosine of its own.
all="--stage-weights 1 --stage-weights 0.5 --stage-weights 1 --stage-weights 1"
anynet finetune --preset default --weights "$out/default-first-stage/weights.safetensors" --steps "${STEPS:-3200}" \
    --seed 2 $all --data "rendered:$out/first" --data "rendered:$out/second" --out "$out/default-all" --resume
anynet finetune --preset default --weights "$out/default-all/weights.safetensors" --steps "${STEPS:-1400}" --seed 3 \
    --learning-rate 8e-4 --warmup-steps 50 $all \
    --data "rendered:$out/first" --data "rendered:$out/second" --out "$out/default-again" --resume
anynet finetune --preset default --weights "$out/default-again/weights.safetensors" --steps "${STEPS:-5000}" --seed 4 \
    $all --data "rendered:$out/first" --data "rendered:$out/second" --data "rendered:$out/third" \
    --out "$out/default-more" --resume
anynet render --out "$out/fourth" --count "${PAIRS:-2400}" --seed 1000000
anynet finetune --preset default --weights "$out/default-more/weights.safetensors" --steps "${STEPS:-14707}" --seed 32 \
    --learning-rate 1.5e-3 --batch-size 12 --ema-decay 0.995 $all \
    --data "rendered:$out/fourth" --out "$out/default-most" --resume
anynet render --out "$out/pairs" --count "${PAIRS:-2400}" --seed 2000000
anynet finetune --preset default --weights "$out/default-most/weights.safetensors" --steps "${STEPS:-17805}" --seed 42 \
    --learning-rate 2e-3 --batch-size 24 --ema-decay 0.995 --smooth-below 0.25 $all \
    --data "rendered:$out/pairs" --out "$out/default" --resume
