"""The estimation methods, by their names in the configuration (`estimator.method`)."""

from __future__ import annotations

from adaptdrive.control.direct_method import DirectMethod
from adaptdrive.control.lambda_method import LambdaMethod
from adaptdrive.control.method import Method

METHODS: dict[str, Method] = {"lm-rls": LambdaMethod(), "rls": DirectMethod()}
