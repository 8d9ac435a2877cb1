"""Writes ascan_reference.txt: a spectrum, its background, and its A-scan computed by numpy in double precision.

Run it with any numpy: python3 ascan_reference.py > ascan_reference.txt
"""
import numpy as np

N = 1024
x = 2 * np.arange(N) / (N - 1) - 1
k = 2 * np.pi / (840e-9 + 50e-9 * x)
u = 2 * (k - k.min()) / (k.max() - k.min()) - 1
phi = 18.0 * u**2 + 4.0 * u**3
source = np.exp(-4 * np.log(2) * ((50e-9 * x) / 50e-9) ** 2)
field = np.ones(N, complex)
for path, amplitude in [(668e-6, 0.02), (703e-6, 0.006), (758e-6, 0.005), (908e-6, 0.012)]:
    field += amplitude * np.exp(1j * (2 * k * path + phi))
rng = np.random.default_rng(1)
electrons = 82.5e3 * source * np.abs(field) ** 2
electrons += rng.normal(size=N) * np.sqrt(electrons + 3600)
counts = np.clip(np.floor(electrons * 4095 / 150e3 + 0.5), 0, 4095)
background = np.clip(np.floor(82.5e3 * source * 4095 / 150e3 + 0.5), 0, 4095)

line = counts - background
wanted = k[0] + (k[-1] - k[0]) * np.arange(N) / (N - 1)
pixel = np.interp(-wanted, -k, np.arange(N))
first = np.clip(np.floor(pixel).astype(int) - 1, 0, N - 4)
t = pixel - first - 1
weights = np.stack([
    0.5 * (-t + 2 * t**2 - t**3),
    0.5 * (2 - 5 * t**2 + 3 * t**3),
    0.5 * (t + 4 * t**2 - 3 * t**3),
    0.5 * (t**3 - t**2),
])
linear = sum(weights[j] * line[first + j] for j in range(4))
window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(N) / N)
place = -(2 * np.arange(N) / (N - 1) - 1)  # wavenumbers fall along the line
spectrum = np.fft.fft(linear * window * np.exp(1j * (18.0 * place**2 + 4.0 * place**3)))
ascan = 10 * np.log10(np.maximum(np.abs(spectrum[: N // 2]) ** 2, 1e-20))

print("# Written by ascan_reference.py. Lines: counts, background, A-scan in dB.")
print(" ".join(str(int(c)) for c in counts))
print(" ".join(str(int(c)) for c in background))
print(" ".join(f"{a:.4f}" for a in ascan))
