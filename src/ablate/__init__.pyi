from .pretrained import load as load
