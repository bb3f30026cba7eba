"""Gymnasium environments: one quadrotor on an attitude estimator of your choice, and its batched twin."""

from .batch import QuadrotorVectorEnv
from .single import QuadrotorEnv

__all__ = ["QuadrotorEnv", "QuadrotorVectorEnv"]
