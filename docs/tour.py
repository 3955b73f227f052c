# %% [markdown]
# # A tour in ten cells
# From `gym.make` to a comparison. Open it as a notebook (VS Code, Jupytext), or run it: `python docs/tour.py`.
# It needs the extras `train` and `view`, takes about half a minute, and writes into the folder `tour`.

# %% 1. An environment: 36 numbers to see, 4 to act with, zero is hover
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
print(f"Nobody at the controls: it leans {np.degrees(info['tilt']):.0f}° after {env.unwrapped.world.clock[0]} steps")

# %% 2. A picture of it
from PIL import Image

Image.fromarray(env.render()).save(FOLDER / "fallen.png")

# %% 3. The paper's controller flies it, by the `predict` that policies of Stable-Baselines3 have too
from quadpend_baselines import controller

pilot, memory = controller("adrc-paper"), None
observation, info = env.reset(seed=1)
for _ in range(400):
    action, memory = pilot.predict(observation, memory)
    observation, reward, terminated, truncated, info = env.step(action)
print(f"ADRC-DESO: {1e3 * np.linalg.norm(info['tracking_error']):.1f} mm off the reference after 4 s")
Image.fromarray(env.render()).save(FOLDER / "flying.png")

# %% 4. Wind, from a model or a sum of models
from quadpend_gym import Dryden, Gusts

wind = Dryden("light") + Gusts(force=(0.5, 0.0, 0.0))
windy = gym.make("QuadPendulum-v0", wind=wind)
windy.reset(seed=1)
print("Wind on the quadrotor, N:", windy.step(np.zeros(4, np.float32))[-1]["disturbance"][:3].round(3))

# %% 5. Sensors and actuators as they are: wrappers
from quadpend_gym.actuators import MotorLag
from quadpend_gym.sensors import Noise
from quadpend_gym.wrappers import ActuatorWrapper, SensorWrapper

real = ActuatorWrapper(SensorWrapper(windy, Noise(position=0.002, direction=0.002)), MotorLag(0.02))
observation, info = real.reset(seed=1)
seen = quadpend_gym.read_observation(observation, "tracking_error")
print("A tracking error of", info["tracking_error"].round(4), "m is seen as", seen.round(4))

# %% 6. Many at once, in one compiled loop, as Stable-Baselines3 likes them
from quadpend_train.envs.sb3_vec_env import SB3VecEnv

envs = SB3VecEnv(gym.make_vec("QuadPendulum-v0", num_envs=256, wind="windy", autoreset_mode="SameStep"))

# %% 7. PPO, plain. 100 000 steps take seconds and are too few: it takes millions to balance
from stable_baselines3 import PPO

model = PPO("MlpPolicy", envs, n_steps=64, batch_size=2048, n_epochs=5, learning_rate=1e-3, device="cpu", seed=0)
model.learn(100_000)
model.save(FOLDER / "mine.zip")

# %% 8. A policy that comes with the package, and executes nothing when it is loaded
from quadpend_train.policies.mlp_policy import MlpPolicy

learned = MlpPolicy.load("ppo-pace-0")
print(
    "Trained in", learned.card["settings"]["scenario"], "for", learned.card["settings"]["total_timesteps"], "decisions"
)

# %% 9. Everybody in the same episodes
from quadpend_train.evaluation.comparison import compare
from quadpend_train.reports.tables import markdown

policies = {"adrc": "adrc-paper", "flatness": "flatness", "mine": str(FOLDER / "mine.zip"), "pace": "ppo-pace-0"}
comparison = compare(policies, {"calm": "calm", "windy": "windy"}, episodes=10, folder=FOLDER / "store")
print(markdown(comparison))

# %% 10. And side by side, to look at
from quadpend_train.cli.watch import watch

watch(("adrc-paper", "ppo-pace-0"), scenario="windy", seconds=(0.0, 2.0), size=(640, 360), out=FOLDER / "windy.gif")
