"""Rotations of batched vectors; quaternions are (w, x, y, z)."""

import torch
from torch import Tensor


def rotate(quat: Tensor, vector: Tensor) -> Tensor:
    """Rotate (n, 3) vectors by (n, 4) unit quaternions: base to world for a base orientation."""
    w, xyz = quat[:, :1], quat[:, 1:]
    t = 2.0 * torch.linalg.cross(xyz, vector)
    return vector + w * t + torch.linalg.cross(xyz, t)


def rotate_inverse(quat: Tensor, vector: Tensor) -> Tensor:
    """Rotate (n, 3) vectors by the inverse of (n, 4) unit quaternions: world to base."""
    w, xyz = quat[:, :1], quat[:, 1:]
    t = 2.0 * torch.linalg.cross(xyz, vector)
    return vector - w * t + torch.linalg.cross(xyz, t)


def yaw_of(quat: Tensor) -> Tensor:
    """(n,) heading of (n, 4) orientations: angle of the body's x axis in the horizontal plane [rad]."""
    w, x, y, z = quat.unbind(-1)
    return torch.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quat_of_yaw(yaw: Tensor) -> Tensor:
    """(n, 4) quaternions of rotations by (n,) angles about the vertical axis [rad]."""
    zero = torch.zeros_like(yaw)
    return torch.stack([torch.cos(yaw / 2), zero, zero, torch.sin(yaw / 2)], dim=-1)
