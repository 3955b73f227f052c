# %% [markdown]
# # A tour in ten cells
# This tour goes from `gym.make` to a comparison of policies. Run it with `python docs/tour.py`, or open the notebook
# `docs/tour.ipynb`, which `python -m docs.tools.notebook` makes from this file. It needs the extras `train` and `view`,
# takes half a minute, and writes into the folder `tour`.

# %% 1. An environment: 36 observed numbers, 4 actions; zero is the hover thrust
from pathlib import Path

import gymnasium as gym
import numpy as np

import quadpend_gym

FOLDER = Path("tour")
FOLDER.mkdir(exist_ok=True)
env = gym.make("QuadPendulum-v0", render_mode="rgb_array")
observation, info = env.reset(seed=1)
terminated = False
while not terminated:
    observation, reward, terminated, truncated, info = env.step(np.zeros(4, np.float32))
steps = env.unwrapped.world.clock[0]
print(f"Without a controller the pendulum leans {np.degrees(info['tilt']):.0f}° after {steps} steps")

# %% 2. A picture of the environment
from PIL import Image

fallen = Image.fromarray(env.render())
fallen.save(FOLDER / "fallen.png")
fallen

# %% 3. The paper's controller, with the same `predict` method as the policies of Stable-Baselines3
from quadpend_baselines import controller

adrc, memory = controller("adrc-paper"), None
observation, info = env.reset(seed=1)
for _ in range(400):
    action, memory = adrc.predict(observation, memory)
    observation, reward, terminated, truncated, info = env.step(action)
error = np.linalg.norm(info["tracking_error"])
print(f"ADRC-DESO: the tracking error is {1e3 * error:.1f} mm after 4 s")
flying = Image.fromarray(env.render())
flying.save(FOLDER / "flying.png")
flying

# %% 4. Wind: a model or a sum of models
from quadpend_gym import Dryden, Gusts

wind = Dryden("light") + Gusts(force=(0.5, 0.0, 0.0))
windy = gym.make("QuadPendulum-v0", wind=wind)
windy.reset(seed=1)
print("Force of the wind on the quadrotor, N:", windy.step(np.zeros(4, np.float32))[-1]["disturbance"][:3].round(3))

# %% 5. Noisy sensors and slow actuators
from quadpend_gym.actuators import MotorLag
from quadpend_gym.sensors import Noise

noise = Noise(position=0.002, direction=0.002)
noisy = gym.make("QuadPendulum-v0", wind=wind, sensors=noise, actuators=MotorLag(0.02))
observation, info = noisy.reset(seed=1)
measured = quadpend_gym.read_observation(observation, "tracking_error")
print("True tracking error, m:", info["tracking_error"].round(4), " measured:", measured.round(4))

# %% 6. Many sub-environments in one compiled loop, adapted to Stable-Baselines3
from quadpend_train.envs.sb3_vec_env import SB3VecEnv

envs = SB3VecEnv(gym.make_vec("QuadPendulum-v0", num_envs=256, wind="windy", autoreset_mode="SameStep"))

# %% 7. Plain PPO. 100 000 steps take seconds; good tracking takes millions of steps
from stable_baselines3 import PPO

model = PPO("MlpPolicy", envs, n_steps=64, batch_size=2048, n_epochs=5, learning_rate=1e-3, device="cpu", seed=0)
model.learn(100_000)
model.save(FOLDER / "mine.zip")

# %% 8. A trained policy from the package; loading it executes no code
from quadpend_train.policies.mlp_policy import MlpPolicy

learned = MlpPolicy.load("apg-0")
settings = learned.card["settings"]
print("Trained in", settings["scenarios"], "for", settings["total_timesteps"], "timesteps")

# %% 9. A comparison of policies in the same episodes
from quadpend_train import evaluate

policies = {
    "adrc": "adrc-paper",
    "flatness": "flatness",
    "mine": str(FOLDER / "mine.zip"),
    "learned": "apg-0",
}
report = evaluate(policies, ["calm", "windy"], FOLDER / "results", episodes=10, cache_folder=FOLDER / "cache")
print((FOLDER / "results/comparison.md").read_text())

# %% 10. A video of two policies side by side
from quadpend_train.cli.watch import VideoOptions, watch

video = VideoOptions(seconds=(0.0, 2.0), size=(640, 360), out=FOLDER / "windy.gif")
watch(("adrc-paper", "apg-0"), scenarios=("windy",), video=video)
with Image.open(FOLDER / "windy.gif") as frames:
    frames.seek(30)
    picture = frames.convert("RGB")
picture
