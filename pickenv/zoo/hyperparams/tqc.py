"""TQC (sb3-contrib): the parameters of SAC, and how many quantiles TQC has and drops."""

from pickenv.zoo.hyperparams.sac import hyperparams as _sac

hyperparams = {
    name: parameters
    | {
        "policy": str(parameters["policy"]).replace("SacPolicy", "TqcPolicy"),
        "top_quantiles_to_drop_per_net": 2,
        "policy_kwargs": "dict(net_arch=[64, 64], n_quantiles=15)",
    }
    for name, parameters in _sac.items()
}
