"""Records what automatic differentiation (`autograd` 1.9, in double precision) makes of the decoder of `vae.rs`: features,
and the gradient to the code of the sum of all features times a given pull.
Run: python decoder_gradient.py > decoder_gradient.json"""
import json

import autograd.numpy as np
from autograd import grad

T, B, D, F, H = 6, 2, 32, 57, 5


def numbers(n, salt):
    i = np.arange(n)
    return (((i * 7919 + salt * 104729) % 1000) / 1000 - 0.5).astype(np.float32).astype(np.float64)


flat, at = numbers(10_000, 1), 0


def affine(n_in, n_out):
    global at
    weight = flat[at:at + n_in * n_out].reshape(n_in, n_out)
    at += n_in * n_out
    bias = flat[at:at + n_out]
    at += n_out
    return lambda x: np.dot(x, weight) + bias


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def direction(n_in, hidden):
    from_input, from_state = affine(n_in, 3 * hidden), affine(hidden, 3 * hidden)

    def run(x, order):
        h, out = np.zeros((B, hidden)), [None] * T
        for t in order:
            xr, xu, xn = np.split(from_input(x[t]), 3, -1)
            hr, hu, hn = np.split(from_state(h), 3, -1)
            r, u = sigmoid(xr + hr), sigmoid(xu + hu)
            n = np.tanh(xn + r * hn)
            h = (1 - u) * n + u * h
            out[t] = h
        return np.stack(out)

    return run


def rectified(x):
    return np.where(x > 0, x, 0.1 * x)


entry = affine(D, H)
ahead, back = direction(H, H), direction(H, H)
merge, head = affine(2 * H, H), affine(2 * H, F)
linear = numbers(D * F, 2).reshape(D, F)


def decoded(code):
    a = rectified(entry(2 * np.tanh(code / 2)))
    g = rectified(merge(np.concatenate([ahead(a, range(T)), back(a, range(T - 1, -1, -1))], -1)))
    return 0.1 + np.dot(code, linear) + 0.1 * 0.5 * head(np.concatenate([g, a], -1))


code = numbers(T * B * D, 3).reshape(T, B, D)
pull = numbers(T * B * F, 4).reshape(T, B, F)
d_code = grad(lambda code: np.sum(decoded(code) * pull))(code)
print(json.dumps({name: values.round(9).flatten().tolist() for name, values in [("features", decoded(code)), ("d_code", d_code)]}))
