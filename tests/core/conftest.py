"""Loads torchvision before any test makes an EGL context: afterwards its import crashes."""

import torchvision  # noqa: F401
