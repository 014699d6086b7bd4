"""From a reconstruction to its description by numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from classify import FeatureVector
    from sapwood.pipeline import Reconstruction

__all__ = ["features_of"]


def features_of(reconstruction: Reconstruction) -> FeatureVector:
    """Describe the tree of a reconstruction by the numbers that species are told apart by.

    Parameters
    ----------
    reconstruction : Reconstruction
        Made with the default allometry; that of a species changes the skeleton, and with it some numbers.

    Returns
    -------
    FeatureVector
        Of its points, its skeleton and its clusters: see :func:`classify.describe_scan`.

    Raises
    ------
    InputError
        If it has fewer than 10 points.

    Examples
    --------
    >>> import sapwood
    >>> tree = sapwood.reconstruct("samples/itsme_tls_tree2.laz")
    >>> round(sapwood.features_of(tree)["height"], 1)
    17.9
    """
    from classify import describe_scan

    return describe_scan(reconstruction.cloud.xyz, reconstruction.tree)
