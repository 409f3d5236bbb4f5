"""Points of error against time."""

import numpy as np
import pandas as pd


def measured_points() -> pd.DataFrame:
    """The simulator with both kinds of scatterers, and a network of which one point alone can be drawn."""
    rows = [("simulator, rays", r, 10.0 * r, metric, 1 / r) for r in (1, 2, 4) for metric in ("mae", "psnr")]
    rows += [("simulator, other", f"rays {r}", 10.0 * r, "mae", 1 / r) for r in (1, 2, 4)]
    rows += [("sa2h", "fp32", 5.0, "mae", 0.4), ("sa2h", "bf16", 3.0, "mae", np.inf), ("sa2h", "int8", 0.0, "mae", 1)]
    return pd.DataFrame(rows, columns=["series", "setting", "ms", "metric", "error"])
