"""Correlations of rasters by real fast Fourier transforms."""

import numpy as np
import torch

_SIZES = (64, 96, 128, 160, 192, 256, 320, 400, 512, 640, 800, 1024, 1280)
"""Quick to transform; few, so that transformed kernels are reused."""


def standard_size(cells: int) -> int:
    """Returns a size quick to transform that holds ``cells``."""
    return next((size for size in _SIZES if size >= cells), int(cells))


def transform(image: np.ndarray) -> torch.Tensor:
    """Returns the spectrum of an (h, w) image, complex64."""
    return torch.fft.rfft2(
        torch.from_numpy(image.astype(np.float32, copy=False))
    )


def kernel_spectrum(raster: np.ndarray, shape: tuple[int, int]) -> torch.Tensor:
    """Returns the spectrum of a raster whose middle cell is the origin.

    An image's spectrum times this one convolves with the raster; times its
    conjugate, it correlates.

    Args:
        raster: (2r + 1)² array, no larger than ``shape``.
        shape: rows and columns of the images it meets.
    """
    padded = np.zeros(shape, dtype=np.float32)
    side = raster.shape[0]
    padded[:side, :side] = raster
    reach = side // 2
    return transform(np.roll(padded, (-reach, -reach), axis=(0, 1)))


def inverse(spectrum: torch.Tensor, shape: tuple[int, int]) -> torch.Tensor:
    """Returns the real (h, w) image of a spectrum."""
    return torch.fft.irfft2(spectrum, s=shape)
