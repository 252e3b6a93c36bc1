#!/usr/bin/env python3
"""Makes reference.json: samples with their statistics according to SciPy, statsmodels and scikit-learn.

  pip install scipy==1.17.1 statsmodels==0.15.0 scikit-learn==1.9.1 && python reference.py > reference.json

A test compares the statistics of facewire-fit with these values (src/statistics.rs).
"""

import json

import numpy as np
import statsmodels.api as sm
from scipy import stats
from sklearn.feature_selection import f_regression
from sklearn.svm import SVR
from statsmodels.stats.diagnostic import het_breuschpagan
from statsmodels.stats.stattools import durbin_watson
from statsmodels.tsa.stattools import acf

random = np.random.default_rng(2024)


def rounded(values):
    """Rounds to six decimals, so that both sides compute with the same numbers."""
    return np.round(np.asarray(values, dtype=float), 6)


def pair(estimate, truth):
    """Agreement of two curves. The estimate must not have ties, because xi breaks them at random."""
    estimate, truth = rounded(estimate), rounded(truth)
    assert len(set(estimate)) == len(estimate)
    difference = estimate - truth
    return {
        "estimate": estimate.tolist(),
        "truth": truth.tolist(),
        "pearson": stats.pearsonr(estimate, truth).statistic,
        "spearman": stats.spearmanr(estimate, truth).statistic,
        "xi": stats.chatterjeexi(estimate, truth).statistic,
        "mse": float(np.mean(difference**2)),
        "deviation": float(np.std(difference, ddof=1)),
        "r_squared": float(1 - np.sum(difference**2) / np.sum((truth - truth.mean()) ** 2)),
    }


def regression(columns, truth):
    """Ordinary least squares of the truth on the columns, and its diagnostics."""
    columns, truth = rounded(columns), rounded(truth)
    design = sm.add_constant(columns)
    fit = sm.OLS(truth, design).fit()
    lagrange, lagrange_p, f, f_p = het_breuschpagan(fit.resid, design)
    return {
        "columns": columns.T.tolist(),
        "residuals": fit.resid.tolist(),
        "r_squared": fit.rsquared,
        "f": [fit.fvalue, fit.f_pvalue],
        "durbin_watson": durbin_watson(fit.resid),
        "breusch_pagan": [lagrange, lagrange_p],
        "breusch_pagan_f": [f, f_p],
        "autocorrelation": acf(fit.resid, nlags=6).tolist(),
    }


def normality(values):
    values = rounded(values)
    w, p = stats.shapiro(values)
    return {"values": values.tolist(), "w": float(w), "p": float(p)}


def long_sample(count):
    """A sample too long to store: squares of the fractional parts of multiples of the golden ratio."""
    values = (np.arange(1, count + 1) * 0.618033988749895 % 1.0) ** 2
    w, p = stats.shapiro(values)
    return {"count": count, "w": float(w), "p": float(p)}


def features(columns, groups, truth):
    """F of each column alone, and partial F of each column, controlling for the others and the groups."""
    columns, truth = rounded(columns), rounded(truth)
    members = (groups[:, None] == np.unique(groups)).astype(float)

    def partial(column):
        without = np.hstack([np.delete(columns, column, axis=1), members])
        full = sm.OLS(truth, np.hstack([columns[:, [column]], without])).fit()
        return full.compare_f_test(sm.OLS(truth, without).fit())[0]

    return {
        "columns": columns.T.tolist(),
        "groups": groups.tolist(),
        "truth": truth.tolist(),
        "f_alone": f_regression(columns, truth)[0].tolist(),
        "partial_f": [partial(column) for column in range(columns.shape[1])],
    }


def correlated_features():
    """Four features of 90 rows in six groups. The second feature is correlated with the first."""
    columns = random.normal(0, 1, (90, 4))
    columns[:, 1] += 2 * columns[:, 0]
    groups = np.arange(90) % 6
    return features(columns, groups, columns @ [1, 0, 0.5, 0] + 0.7 * groups + random.normal(0, 1, 90))


def support_vectors(values, truth, places):
    """Support vector regression on one standardised feature."""
    values, truth, places = rounded(values), rounded(truth), rounded(places)

    def scaled(some):
        return ((some - values.mean()) / values.std(ddof=1))[:, None]

    fitted = SVR(kernel="rbf", gamma=1.0, C=1.0, epsilon=0.05, tol=1e-5).fit(scaled(values), truth)
    return {
        "values": values.tolist(),
        "truth": truth.tolist(),
        "places": places.tolist(),
        "estimates": fitted.predict(scaled(places)).tolist(),
    }


def main():
    x = random.uniform(0, 1, 80)
    noise = random.normal(0, 1, 80)
    three = random.normal(0, 1, (120, 3))
    # Weight of 11 men in pounds: the example of Shapiro and Wilk (1965).
    weights = [148, 154, 158, 160, 161, 162, 166, 170, 182, 195, 236]
    print(json.dumps({
        "pairs": [
            pair(x, np.clip(x + 0.2 * noise, 0, 1)),
            pair(x, np.sin(6 * x)),
            pair(x, np.round(5 * random.uniform(0, 1, 80)) / 5),
            pair([0.1, 0.2, 0.4], [0.3, 0.2, 0.9]),
        ],
        "regressions": [
            regression(three, 1 + three @ [0.5, -1, 0] + random.normal(0, 1, 120)),
            regression(three, three @ [0.5, -1, 0.2] + random.normal(0, 1, 120) * np.exp(0.5 * three[:, 0])),
            regression(x[:, None], x + 0.3 * np.cumsum(noise)),
        ],
        "normalities": [
            normality(weights),
            normality(random.normal(0, 1, 3)),
            normality(random.normal(0, 1, 5)),
            normality(random.exponential(1, 10)),
            normality(random.normal(0, 1, 12)),
            normality(random.uniform(0, 1, 60)),
            normality(random.normal(0, 1, 300)),
        ],
        "long_normalities": [long_sample(1250), long_sample(5000)],
        "features": correlated_features(),
        "support_vectors": support_vectors(x, np.clip(np.sin(4 * x) + 0.1 * noise, 0, 1), random.uniform(0, 1, 20)),
    }, indent=None, separators=(",", ":")))


main()
