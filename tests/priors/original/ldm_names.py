"""What a checkpoint of the release calls the weights of diffusers' UNet and autoencoder."""

import re

from torch import Tensor

RESIDUAL = {"norm1": "in_layers.0", "conv1": "in_layers.2", "time_emb_proj": "emb_layers.1", "norm2": "out_layers.0",
            "conv2": "out_layers.3", "conv_shortcut": "skip_connection"}  # fmt: skip
UNET = {"conv_in": "input_blocks.0.0", "time_embedding.linear_1": "time_embed.0", "time_embedding.linear_2": "time_embed.2",
        "conv_norm_out": "out.0", "conv_out": "out.2", "mid_block.resnets.0": "middle_block.0",
        "mid_block.attentions.0": "middle_block.1", "mid_block.resnets.1": "middle_block.2"}  # fmt: skip
VAE = {"conv_norm_out": "norm_out", "mid_block.resnets.0": "mid.block_1", "mid_block.attentions.0": "mid.attn_1",
       "mid_block.resnets.1": "mid.block_2", "conv_shortcut": "nin_shortcut", "downsamplers.0": "downsample",
       "upsamplers.0": "upsample", "group_norm": "norm", "to_q": "q", "to_k": "k", "to_v": "v", "to_out.0": "proj_out",
       "resnets": "block"}  # fmt: skip


def of_unet(state: dict[str, Tensor], layers: int) -> dict[str, Tensor]:
    """The UNet's, whose blocks the release counts through all levels, ``layers`` residual ones in each on the way down."""
    attended = {key.split(".")[1] for key in state if re.match(r"up_blocks\.\d+\.attentions", key)}

    def block(found: re.Match[str]) -> str:
        way, level, kind, place = found[1], int(found[2]), found[3], int(found[4])
        if kind == "downsamplers":
            return f"input_blocks.{(level + 1) * (layers + 1)}.0.op"
        if kind == "upsamplers":
            return f"output_blocks.{(level + 1) * (layers + 1) - 1}.{1 + (found[2] in attended)}"
        number = level * (layers + 1) + place + (way == "down")
        return f"{'input' if way == 'down' else 'output'}_blocks.{number}.{int(kind == 'attentions')}"

    def name(key: str) -> str:
        key = re.sub(r"^(down|up)_blocks\.(\d+)\.(\w+)\.(\d+)(?:(?<=downsamplers\.0)\.conv)?", block, key)
        for ours, theirs in UNET.items():
            key = re.sub(rf"^{re.escape(ours)}(?=\.)", theirs, key)
        if re.match(r"(in|out)put_blocks\.\d+\.0\.|middle_block\.[02]\.", key):
            for ours, theirs in RESIDUAL.items():
                key = key.replace(f".{ours}.", f".{theirs}.")
        return key

    return {name(key): value for key, value in state.items()}


def of_vae(state: dict[str, Tensor]) -> dict[str, Tensor]:
    """The autoencoder's, whose levels count from the finest in the release and whose attention is by 1 x 1 convolutions."""
    levels = {int(found[1]) for key in state if (found := re.match(r"decoder\.up_blocks\.(\d+)", key))}

    def name(key: str) -> str:
        key = re.sub(r"down_blocks\.(\d+)\.", r"down.\1.", key)
        key = re.sub(r"up_blocks\.(\d+)\.", lambda found: f"up.{max(levels) - int(found[1])}.", key)
        for ours, theirs in VAE.items():
            key = key.replace(f".{ours}.", f".{theirs}.")
        return key

    return {name(key): value[..., None, None] if value.ndim == 2 else value for key, value in state.items()}
