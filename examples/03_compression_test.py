"""Young's modulus of cylinders pressed between plates, as a second opinion on a fit.

python examples/03_compression_test.py
"""

from pathlib import Path

from palpate.probe import (
    compression_series,
    compression_test,
    gent_lindley_factor,
    read_compression,
)

HERE = Path(__file__).parent
STRAIN_RANGE = (0.02, 0.10)  # leaves out the first contact


def main() -> float:
    """Three tests of Ecoflex 00-30; gives the mean Young's modulus [Pa]."""
    results = []
    for path in sorted((HERE / "cylinder").glob("*.csv")):
        record = read_compression(path)
        result = compression_test(
            record.displacement,
            record.force,
            diameter=record.diameter,
            height=record.height,
            strain_range=STRAIN_RANGE,
            source=path.name,
        )
        low, high = result.ci95
        print(
            f"{path.name}: E = {1e-3 * result.young_modulus:.1f} kPa, "
            f"95 % interval {1e-3 * low:.1f} to {1e-3 * high:.1f} kPa"
        )
        results.append(result)
    series = compression_series(results)
    print(f"mean {1e-3 * series.young_modulus:.1f} kPa, spread {1e-3 * series.spread:.1f} kPa")
    factor = gent_lindley_factor(results[0].diameter, results[0].height)
    print(f"if the ends stuck, divide by about {factor:.2f}")
    return series.young_modulus


if __name__ == "__main__":
    main()
