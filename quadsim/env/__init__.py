"""Gymnasium environments: one quadrotor with an attitude estimator, and the batched version."""

from .batch import QuadrotorVectorEnv
from .single import QuadrotorEnv

__all__ = ["QuadrotorEnv", "QuadrotorVectorEnv"]
