"""Records what PyTorch's autograd, in double precision, makes of the decoder of `vae.rs`: features, and the gradient to
the code of the sum of all features times a given pull. Run: python decoder_gradient.py > decoder_gradient.json"""
import json
import torch

T, B, D, F, H = 6, 2, 32, 57, 5
torch.set_default_dtype(torch.float64)


def numbers(n, salt):
    i = torch.arange(n)
    return (((i * 7919 + salt * 104729) % 1000).double() / 1000 - 0.5).float().double()


flat, at = numbers(10_000, 1), 0


def affine(n_in, n_out):
    global at
    weight = flat[at:at + n_in * n_out].view(n_in, n_out)
    at += n_in * n_out
    bias = flat[at:at + n_out]
    at += n_out
    return lambda x: x @ weight + bias


def direction(n_in, hidden):
    from_input, from_state = affine(n_in, 3 * hidden), affine(hidden, 3 * hidden)

    def run(x, order):
        h, out = torch.zeros(B, hidden), [None] * T
        for t in order:
            (xr, xu, xn), (hr, hu, hn) = from_input(x[t]).split(hidden, -1), from_state(h).split(hidden, -1)
            r, u = torch.sigmoid(xr + hr), torch.sigmoid(xu + hu)
            n = torch.tanh(xn + r * hn)
            h = (1 - u) * n + u * h
            out[t] = h
        return torch.stack(out)

    return run


def rectified(x):
    return torch.nn.functional.leaky_relu(x, 0.1)


entry = affine(D, H)
ahead, back = direction(H, H), direction(H, H)
merge, head = affine(2 * H, H), affine(2 * H, F)
linear = numbers(D * F, 2).view(D, F)
code = numbers(T * B * D, 3).view(T, B, D).requires_grad_()
a = rectified(entry(code))
g = rectified(merge(torch.cat([ahead(a, range(T)), back(a, range(T - 1, -1, -1))], -1)))
features = 0.1 + code @ linear + 0.1 * 0.5 * head(torch.cat([g, a], -1))
(features * numbers(T * B * F, 4).view(T, B, F)).sum().backward()
print(json.dumps({"features": features.flatten().tolist(), "d_code": code.grad.flatten().tolist()}))
