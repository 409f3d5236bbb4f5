"""PSNR, MAE, patch chi-square, Frechet and kernel distance, and the metrics of mechanism."""

from ablate.metrics.choice import FID_METRICS, METRIC_SETS, SET_METRICS, SPECKLE_METRICS, Metrics, choose_metrics
from ablate.metrics.distances import frechet_distance, kernel_distance
from ablate.metrics.evaluation import IMAGE_METRICS, METRICS_VERSION, ImageMetric, Pair, evaluate_image
from ablate.metrics.features import FEATURE_NAMES, speckle_features
from ablate.metrics.fidelity import mae, psnr
from ablate.metrics.inception import InceptionFeatures, inception_file, load_inception
from ablate.metrics.intervals import bootstrap_interval
from ablate.metrics.mechanism import mae_smooth, noise_sd, nyquist_excess, shadow_contrast
from ablate.metrics.patch_histograms import patch_chi2, patches_inside, rms

__all__ = [
    "FEATURE_NAMES",
    "FID_METRICS",
    "IMAGE_METRICS",
    "METRICS_VERSION",
    "METRIC_SETS",
    "SET_METRICS",
    "SPECKLE_METRICS",
    "ImageMetric",
    "InceptionFeatures",
    "Metrics",
    "Pair",
    "bootstrap_interval",
    "choose_metrics",
    "evaluate_image",
    "frechet_distance",
    "inception_file",
    "kernel_distance",
    "load_inception",
    "mae",
    "mae_smooth",
    "noise_sd",
    "nyquist_excess",
    "patch_chi2",
    "patches_inside",
    "psnr",
    "rms",
    "shadow_contrast",
    "speckle_features",
]
