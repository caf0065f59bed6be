#!/bin/bash
# Training on a machine with a GPU that has PyTorch, and neither this project nor a way to anywhere.
#
#   bash training/on_gpu.sh pack TRAIN OUT [3.12]           # here: OUT, less than 64 MB, of TRAIN/world and TRAIN/held_out, for that Python
#   bash OUT/on_gpu.sh train OUT WEIGHTS [KEY=VALUE ...]    # there: WEIGHTS.tar with the weights, WEIGHTS.jsonl with how they were judged
#
# NETWORK=diffusion for the other network. Scenes are judged here, from the weights that come back (python -m ia_bench_training.single_view).
set -e
export XZ_OPT=-2
network=${NETWORK:-regressor}
wheels="pydantic pydantic-core annotated-types typing-inspection diffusers importlib-metadata"
case $1 in
pack)
    train=$2 out=$3 python=${4:-3.12}
    mkdir -p "$out/wheels"
    python -m ia_bench_training.world.travel world="$train/world" out="$out/world"
    tar cJf "$out/world.tar.xz" -C "$out" world && rm -r "$out/world"
    tar cJf "$out/held_out.tar.xz" -C "$train" held_out
    git ls-files ia_bench training | grep -v /weights/ | tar cJf "$out/code.tar.xz" -T - "ia_bench/priors/weights/$network"
    versions=$(python -c 'import sys; from importlib.metadata import version; print(*(f"{n}=={version(n)}" for n in sys.argv[1:]))' $wheels)
    ${PIP:-pip} download -q --no-deps --only-binary=:all: --python-version "$python" --platform manylinux2014_x86_64 -d "$out/wheels" $versions
    cp "$0" "$out/on_gpu.sh"
    du -sh "$out"
    ;;
train)
    from=$(realpath "$2") to=$(realpath -m "$3")
    shift 3
    place=$(mktemp -d)
    for part in code world held_out; do tar xf "$from/$part.tar.xz" -C "$place"; done
    ${PIP:-python3 -m pip} install -q --no-index --no-deps --no-compile --target "$place/site" "$from"/wheels/*.whl
    export PYTHONPATH=$place:$place/training:$place/site:$PYTHONPATH PYTHONUNBUFFERED=1
    cd "$place"
    python3 -m ia_bench_training.train data=world validation=held_out out=run network.kind="$network" \
        init="ia_bench/priors/weights/$network" batch=512 steps=4000 warmup=100 rate=5e-4 muon_rate=0.02 compile=false \
        $([ "$network" = regressor ] && echo log_error=0.01) level=0.05 augmentation.cast=0.05 augmentation.permute=0.03 \
        validate_steps=250 validation_images=92 minutes=10 "$@"
    tar cf "$to.tar" -C run weights
    cp run/validation.jsonl "$to.jsonl"
    ;;
*)
    sed -n '2,8s/^# \?//p' "$0"
    exit 2
    ;;
esac
