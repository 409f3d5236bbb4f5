"""What is scored as tissue."""

from ablate.anatomy import load_tissues
from ablate.evaluation import tissue_labels

FLUID_OR_GAS = {"coupling_gel", "amniotic_fluid", "urine", "bile", "csf", "blood", "gas"}


def test_tissue_is_all_but_fluid_and_gas():
    table = load_tissues()
    labels = tissue_labels(tuple(table.values()))
    assert [name in FLUID_OR_GAS for name in table] == [k + 1 not in labels for k in range(len(table))]
