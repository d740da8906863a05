"""
Estimation: coverage of the intervals
=====================================

An estimator is trained on synthetic rows of data whose noise grows with one of the features. It
then gives prediction intervals for new rows. Intervals of 90 % should contain 90 % of the true
values, within the binomial deviation.
"""

# %%
import matplotlib.pyplot as plt
import numpy as np

from acoustube.estimation import Boosting

random = np.random.default_rng(7)


def rows(n):
    """Return features (n, 3) and targets (n, 1), with noise that grows with the second feature."""
    x = random.uniform(-1, 1, (n, 3))
    y = (
        np.sin(3 * x[:, 0])
        + x[:, 2] ** 2
        + (0.05 + 0.2 * (x[:, 1] + 1)) * random.standard_normal(n)
    )
    return x, y[:, None]


# %%
# Train, and count the true values inside
# ---------------------------------------
x, y = rows(2000)
estimator = Boosting(max_iter=80, n_folds=5).fit(x, y)
x_new, y_new = rows(2000)
residual = np.abs(estimator.predict(x_new).reshape(-1) - y_new[:, 0])
nominal = np.array([0.5, 0.6, 0.68, 0.8, 0.9, 0.95])
widths = [np.reshape(estimator.half_width(x_new, coverage), -1) for coverage in nominal]
held = np.array([np.mean(residual <= width) for width in widths])
chance = 2 * np.sqrt(nominal * (1 - nominal) / len(x_new))
for asked, found in zip(nominal, held, strict=True):
    print(f"nominal coverage {100 * asked:.0f} %, observed {100 * found:.1f} %")

# %%
# The intervals are wider where the noise is larger.
low = x_new[:, 1] < -0.5
ratio = float(np.mean(widths[4][~low]) / np.mean(widths[4][low]))
print(f"intervals are {ratio:.1f} times as wide where the noise is large")

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
left.fill_between(
    100 * nominal, -100 * chance, 100 * chance, color="0.9", label="chance, two deviations"
)
left.plot(100 * nominal, 100 * (held - nominal), "o-", label="observed minus nominal")
left.axhline(0, color="k", lw=1, ls="--")
left.set(xlabel="nominal coverage (%)", ylabel="percentage points")
left.legend()
true_width = 1.645 * (0.05 + 0.2 * (x_new[:, 1] + 1))
right.plot(x_new[:, 1], widths[4], ".", ms=2, label="stated half width, 90 %")
right.plot(np.sort(x_new[:, 1]), np.sort(true_width), "k--", lw=1, label="that of the true noise")
right.set(xlabel="feature that sets the noise", ylabel="half width")
right.legend()
plt.show()
