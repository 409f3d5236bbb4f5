"""Angular widths of points in PyMUST by depth, and the power that comes through side lobes.

python scripts/against_pymust/widths.py
"""

import numpy as np
import pandas as pd
from pymust_array import Array, Scatterers, images, point_widths

DEPTHS_MM = [10.0, 30.0, 50.0, 70.0, 100.0, 130.0]
BESIDE_MM = 7.0
ARRAYS = {
    "3 MHz, f-number 1": Array(),
    "3 MHz, f-number 2": Array(f_number=2.0),
    "5 MHz, f-number 1.5": Array(frequency_mhz=5.0, elements=128, f_number=1.5),
}


def beside_db(array: Array) -> list[float]:
    """Share of the power of each point that comes from more than `BESIDE_MM` beside it, dB."""
    depth, angle = np.arange(6.0, 135.0, 0.1), np.radians(np.linspace(-25, 25, 251))
    cloud = Scatterers(np.zeros(len(DEPTHS_MM)), np.array(DEPTHS_MM), np.ones(len(DEPTHS_MM)))
    power = np.abs(images(array, [cloud], depth, angle)[0]) ** 2
    shares = []
    for point_mm in DEPTHS_MM:
        across = power[np.abs(depth - point_mm) < 3].sum(axis=0)
        far = np.abs((array.radius_mm + point_mm) * angle) > BESIDE_MM
        shares.append(float(10 * np.log10(across[far].sum() / across.sum())))
    return shares


def main() -> None:
    """Print both tables."""
    radii = np.array([[array.radius_mm + depth for depth in DEPTHS_MM] for array in ARRAYS.values()])
    widths = np.array([point_widths(array, DEPTHS_MM).lateral_mm for array in ARRAYS.values()])
    columns = [f"{depth:.0f} mm" for depth in DEPTHS_MM]
    print("angular width, mrad")
    print(pd.DataFrame(1e3 * widths / radii, list(ARRAYS), columns).round(1).to_string())
    print(f"power from more than {BESIDE_MM:g} mm beside a point, dB")
    print(pd.DataFrame([beside_db(array) for array in ARRAYS.values()], list(ARRAYS), columns).round(1).to_string())


if __name__ == "__main__":
    main()
