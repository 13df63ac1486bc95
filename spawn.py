import gymnasium as gym, numpy as np, sys, isd_gym
if __name__ == "__main__":
    for how in ("fork", "spawn"):
        e = gym.make_vec("ISDSuspension-v0", 2, vectorization_mode="async", vector_kwargs={"context": how})
        e.reset(seed=0)
        o, r, *_ = e.step(np.zeros((2, 1), np.float32))
        print(how, np.isfinite(o).all(), r.shape, flush=True)
        e.close()
