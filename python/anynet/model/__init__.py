"""The network: one file per part, each with the part's deployed form beside its module.

`config` says what it is made of, `presets` names some, `anynet` is the module, `deploy` what a `Predictor` runs.
"""
