"""What a network reads of the labels."""

from dataclasses import replace

import numpy as np
import pytest

from ablate.anatomy import load_tissues
from ablate.dataset import Encoding, alike_labels, label_values


def test_labels_that_are_read_as_one_are_named() -> None:
    liver = load_tissues()["liver"]
    bright, brighter = (replace(liver, name=name, scatterer_sd=sd) for name, sd in (("bright", 5.0), ("brighter", 9.0)))
    tissues = (liver, bright, brighter)
    values = label_values(tissues, Encoding.properties)
    np.testing.assert_array_equal(values[2], values[3])
    assert alike_labels(tissues, values) == ["The network reads the same for bright and brighter."]
    for encoding in (Encoding.echogenicity, Encoding.arbitrary):
        assert alike_labels(tissues, label_values(tissues, encoding)) == []


def test_a_word_is_the_encoding_that_it_names() -> None:
    tissues = tuple(load_tissues().values())
    for encoding in Encoding:
        named = label_values(tissues, encoding.value)  # type: ignore[arg-type]
        np.testing.assert_array_equal(named, label_values(tissues, encoding))
    with pytest.raises(ValueError, match="nonsense"):
        label_values(tissues, "nonsense")  # type: ignore[arg-type]
