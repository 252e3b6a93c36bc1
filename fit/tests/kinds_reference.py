#!/usr/bin/env python3
"""Makes kinds_reference.json: predictions of scikit-learn's models for synthetic faces.

  pip install numpy scikit-learn==1.9.1 && python kinds_reference.py > kinds_reference.json

A test compares the kinds of facewire-fit with these values on the same faces (src/kinds/mod.rs).
"""

import json

import numpy as np
from sklearn.cross_decomposition import PLSRegression
from sklearn.decomposition import PCA
from sklearn.ensemble import GradientBoostingRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, Matern
from sklearn.linear_model import LinearRegression, Ridge
from sklearn.neighbors import KNeighborsRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures

SEEN, NEW, FEATURES = 80, 5, 20


def faces():
    """Pseudo-random numbers between -1 and 1: fractional parts of large multiples of sines."""
    index = np.arange(1, (SEEN + NEW) * FEATURES + 1)
    return (2 * (np.sin(index * 12.9898) * 43758.5453 % 1) - 1).reshape(-1, FEATURES)


def ridge(columns, part):
    """Ridge regression with a penalty relative to the columns' mean sum of squares about their means."""
    return Ridge(part * np.mean(np.sum((columns - columns.mean(axis=0)) ** 2, axis=0)))


def gaussian_process(kernel, seen, truth):
    """Chooses length scale and noise from a grid by likelihood, with the most likely signal variance for each."""
    unit = np.sqrt(FEATURES)
    centred = truth - truth.mean()

    def likelihood(choice):
        covariance = kernel(choice[0] * unit)(seen) + choice[1] * np.eye(SEEN)
        variance = centred @ np.linalg.solve(covariance, centred) / SEEN
        return -0.5 * SEEN * np.log(variance) - 0.5 * np.linalg.slogdet(covariance)[1]

    grid = [(length, noise) for length in (0.7, 1.4, 2.8, 5.6) for noise in (0.003, 0.03, 0.15, 0.6)]
    length, noise = max(grid, key=likelihood)
    return GaussianProcessRegressor(kernel(length * unit), alpha=noise, optimizer=None), truth.mean()


def main():
    every = faces()
    seen, new = every[:SEEN], every[SEEN:]
    x = seen.T
    truth = 0.4 + 0.2 * x[0] - 0.1 * x[1] + 0.1 * x[2] * x[3] + 0.05 * x[4] ** 2
    products = PolynomialFeatures(2, include_bias=False)
    models = {
        "ols": LinearRegression(),
        "ridge": ridge(seen, 0.001),
        "pca": make_pipeline(PCA(0.999), LinearRegression()),
        "pls": PLSRegression(16, scale=False),
        "poly": make_pipeline(products, ridge(products.fit_transform(seen), 0.001)),
        "knn": KNeighborsRegressor(8, weights="distance"),
        "gb": GradientBoostingRegressor(random_state=0),
    }
    predictions = {name: model.fit(seen, truth).predict(new).ravel().tolist() for name, model in models.items()}
    for name, kernel in [("gp-rbf", RBF), ("gp-matern", lambda length: Matern(length, nu=2.5))]:
        model, mean = gaussian_process(kernel, seen, truth)
        predictions[name] = (mean + model.fit(seen, truth - mean).predict(new)).tolist()
    print(json.dumps(predictions, indent=1))


main()
