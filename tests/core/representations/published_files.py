"""Checkpoint files as others publish them, of the real layout, with made-up numbers."""

import timm
import torch
import torchvision
from torch import nn


def as_if_trained(network, seed=0):
    """Numbers that no initialisation gives, none of them so large that features overflow."""
    generator = torch.Generator().manual_seed(seed)
    for name, tensor in network.state_dict().items():
        if name.endswith(("running_mean", "bias")):
            tensor.copy_(torch.randn(tensor.shape, generator=generator) * 0.05)
        elif tensor.ndim == 1 and name.endswith("weight"):
            tensor.copy_(1 + torch.randn(tensor.shape, generator=generator) * 0.05)
    return network.eval()


def save(content, path):
    torch.save(content, path)
    return path


def r3m_file(path):
    """(file, features that its network computes): R3M's own file also holds language parts."""
    network = as_if_trained(torchvision.models.resnet18(weights=None))
    network.fc = nn.Identity()
    state = {f"module.convnet.{k}": v for k, v in network.state_dict().items()}
    state["module.lang_enc.model.embeddings.word_embeddings.weight"] = torch.randn(10, 4)
    state["module.lang_rew.pred.0.weight"] = torch.randn(4, 4)
    return save({"r3m": state, "global_step": 1_500_000}, path), network


def vip_file(path):
    network = torchvision.models.resnet50(weights=None)
    network.fc = nn.Linear(2048, 1024)
    as_if_trained(network)
    state = {f"module.convnet.{k}": v for k, v in network.state_dict().items()}
    return save({"vip": state, "global_step": 1}, path), network


def xirl_file(path):
    network = torchvision.models.resnet18(weights=None)
    network.fc = nn.Linear(512, 32)
    as_if_trained(network)
    layers = nn.Sequential(*list(network.children())[:-1])
    state = {f"backbone.{k}": v for k, v in layers.state_dict().items()}
    state |= {f"encoder.{k}": v for k, v in network.fc.state_dict().items()}
    return save({"model": state, "optimizer": {"lr": 1e-5}, "step": 4000}, path), network


def liv_file(path):
    """LIV is CLIP's RN50; the names of CLIP's image tower are written out here by hand."""
    network = as_if_trained(timm.create_model("resnet50_clip", num_classes=1024))
    state = {}
    for name, tensor in network.state_dict().items():
        words = name.split(".")
        if words[0] == "stem":
            kind, number = words[2], words[1][-1]
            clip = f"{'bn' if kind == 'bn' else 'conv'}{number}.{words[3]}"
        elif words[0] == "stages":
            block = f"layer{int(words[1]) + 1}.{words[2]}"
            if words[3] == "shortcut":
                clip = f"{block}.downsample.{0 if words[5] == 'conv' else 1}.{words[6]}"
            else:
                clip = f"{block}.{words[4]}{words[3][4]}.{words[5]}"
        else:
            clip = ".".join(words).replace("head.pos_embed", "attnpool.positional_embedding")
            clip = clip.replace("head.proj", "attnpool.c_proj")
            for part in "qkv":
                clip = clip.replace(f"head.{part}.", f"attnpool.{part}_proj.")
        if not clip.endswith("num_batches_tracked"):
            state[f"module.model.visual.{clip}"] = tensor.half() if tensor.ndim == 4 else tensor
    state["module.model.token_embedding.weight"] = torch.randn(10, 4)
    state["module.model.logit_scale"] = torch.tensor(4.6)
    return save({"liv": state}, path), network


def mvp_file(path):
    network = as_if_trained(timm.create_model("vit_small_patch16_224", num_classes=0))
    state = network.state_dict()
    state |= {"mask_token": torch.zeros(1, 1, 512), "decoder_pos_embed": torch.zeros(1, 197, 512)}
    state["decoder_blocks.0.norm1.weight"] = torch.ones(512)
    return save({"model": state}, path), network


def dinov2_file(path):
    """The published file has the positions of 518-pixel pictures and names a mask token."""
    network = as_if_trained(timm.create_model("vit_small_patch14_dinov2", num_classes=0))
    state = network.state_dict()
    state["mask_token"] = torch.zeros(1, 384)
    return save(state, path), network


FILES = {
    "r3m_resnet18": (r3m_file, 512),
    "vip_resnet50": (vip_file, 1024),
    "xirl_resnet18": (xirl_file, 32),
    "liv_resnet50": (liv_file, 1024),
    "mvp_vit_small": (mvp_file, 384),
    "dinov2_vit_small": (dinov2_file, 384),
}
