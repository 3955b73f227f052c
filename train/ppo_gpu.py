"""Train PPO with everything on the GPU: environment, policy, returns and updates. A script to copy, after CleanRL.

    python train/ppo_gpu.py                                                    # the paper's vehicle in calm air
    python train/ppo_gpu.py --scenario windy --seconds 60
    python train/ppo_gpu.py --device c --num-envs 256 --minibatches 16           # without a GPU

A rollout and an update are one CUDA graph each, so Python launches two graphs in an iteration, and nothing waits for
the GPU until the policy is evaluated: on the same scenario, without exploration, one episode in each of 1,024 rows.
Writes `ppo_gpu.pt`: the weights of the policy.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import torch
from torch import Tensor, nn

import quadpend_gym  # noqa: F401  registers the environments


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    """Return the settings."""
    parser = argparse.ArgumentParser(description="Train PPO on a GPU.")
    add = parser.add_argument
    add("--scenario", default=None, help="name or file of a scenario; by default the paper's vehicle in calm air")
    add("--device", default="cuda", help="cuda, or c for the processor")
    add("--kernel", default=None, help="file of the generated kernel, see QuadPendulumDeviceEnv")
    add("--seconds", type=float, default=20.0, help="duration of the training")
    add("--until", type=float, default=2.0, help="stop when this share of the episodes survives; above 1: do not stop")
    add("--seed", type=int, default=0)
    add("--num-envs", type=int, default=4096)
    add("--num-steps", type=int, default=64, help="control steps of a rollout")
    add("--minibatches", type=int, default=32)
    add("--epochs", type=int, default=3)
    add("--lr", type=float, default=2e-3, help="the largest one, which decreases linearly with the time")
    add("--kl", type=float, default=0.01, help="wanted divergence of a policy from the last one, which sets the rate")
    add("--gamma", type=float, default=0.99)
    add("--gae", type=float, default=0.95)
    add("--clip", type=float, default=0.2)
    add("--log-std", type=float, default=-1.0, help="logarithm of the initial standard deviation of the actions")
    add("--hidden", type=int, default=64)
    add("--history", type=int, default=0, help="last actions that the policy sees, for vehicles with a latency")
    add("--evaluate-every", type=float, default=1.0, help="seconds between two evaluations")
    add("--out", default="ppo_gpu.pt")
    return parser.parse_args(arguments)


def mlp(size: int, hidden: int, out: int, gain: float) -> nn.Sequential:
    """Return a network of two hidden layers with orthogonal weights."""
    first, second, last = nn.Linear(size, hidden), nn.Linear(hidden, hidden), nn.Linear(hidden, out)
    for layer, scale in ((first, 2**0.5), (second, 2**0.5), (last, gain)):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(first, nn.Tanh(), second, nn.Tanh(), last)


class Agent(nn.Module):
    """A Gaussian policy and a value function."""

    def __init__(self, size: int, args: argparse.Namespace) -> None:
        super().__init__()
        self.actor, self.critic = mlp(size, args.hidden, 4, 0.01), mlp(size, args.hidden, 1, 1.0)
        self.log_std = nn.Parameter(torch.full((4,), args.log_std))

    def log_prob(self, seen: Tensor, action: Tensor) -> Tensor:
        """Return the logarithm of the density of actions, without its constant."""
        z = (action - self.actor(seen)) * torch.exp(-self.log_std)
        return torch.sum(-0.5 * z * z - self.log_std, -1)

    def value(self, seen: Tensor) -> Tensor:
        """Return the expected return."""
        found: Tensor = self.critic(seen)
        return found.squeeze(-1)


class Rows:
    """An environment with what a rollout must remember: the last observation and the last actions of each row."""

    def __init__(self, args: argparse.Namespace, rows: int, seed: int) -> None:
        self.env: Any = gym.make_vec(
            "QuadPendulum-v0", rows, scenario=args.scenario, device=args.device, kernel=args.kernel
        ).unwrapped
        first, _ = self.env.reset(seed=seed)
        self.history = torch.zeros(rows, 4 * args.history, device=first.device)
        self.seen = torch.cat([first, self.history], 1)

    def step(self, action: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """Return reward, terminated, truncated, what the policy would have seen at the end, and the tracking error."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.history.copy_(torch.cat([self.history, action], 1)[:, 4:] if self.history.numel() else self.history)
        final = torch.cat([info["final_obs"], self.history], 1)
        self.history *= ~info["_final_obs"][:, None]
        self.seen.copy_(torch.cat([observation, self.history], 1))
        return reward, terminated, truncated, final, info["tracking_error"]


def graphed(function: Callable[[], None], device: torch.device, before: Callable[[], None]) -> Callable[[], None]:
    """Return the function as a CUDA graph; `before` undoes what the runs that warm it up changed."""
    if device.type != "cuda":
        return function
    stream: Any = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        for _ in range(2):
            function()
    torch.cuda.current_stream().wait_stream(stream)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        function()
    before()
    return graph.replay


def train(args: argparse.Namespace, report: Callable[[dict[str, Any]], None] = print) -> Agent:
    """Train until the time is over or the policy balances; `report` gets the evaluations."""
    torch.manual_seed(args.seed)
    rows = Rows(args, args.num_envs, args.seed)
    device, steps, n = rows.seen.device, args.num_steps, args.num_envs
    agent = Agent(rows.seen.shape[1], args).to(device)
    lr, largest_lr = torch.tensor(args.lr, device=device), torch.tensor(args.lr, device=device)
    optimizer = torch.optim.Adam(agent.parameters(), lr=lr, eps=1e-5, capturable=device.type == "cuda")
    evaluate = evaluator(args, agent)

    seen = torch.zeros(steps, n, rows.seen.shape[1], device=device)
    actions = torch.zeros(steps, n, 4, device=device)
    log_probs, rewards, values, advantages, returns = torch.zeros(5, steps, n, device=device)
    going = torch.zeros(steps, n, device=device)  # 0 where an episode ended

    @torch.no_grad()
    def rollout() -> None:
        for t in range(steps):
            seen[t] = rows.seen
            noise = torch.randn(n, 4, device=device)
            action = agent.actor(rows.seen) + torch.exp(agent.log_std) * noise
            actions[t], values[t] = action, agent.value(rows.seen)
            log_probs[t] = -(0.5 * noise * noise + agent.log_std).sum(-1)
            reward, terminated, truncated, final, _ = rows.step(action)
            cut = truncated & ~terminated  # the episode would have gone on
            rewards[t] = (1.0 - args.gamma) * reward + args.gamma * torch.where(cut, agent.value(final), 0.0)
            going[t] = (~(terminated | truncated)).float()
        following, advantage = agent.value(rows.seen), torch.zeros(n, device=device)
        for t in reversed(range(steps)):
            delta = rewards[t] + args.gamma * following * going[t] - values[t]
            advantage = delta + args.gamma * args.gae * going[t] * advantage
            advantages[t], following = advantage, values[t]
        torch.add(advantages, values, out=returns)

    def update() -> None:
        size = steps * n // args.minibatches
        flat = [item.reshape(steps * n, *item.shape[2:]) for item in (seen, actions, log_probs, advantages, returns)]
        for _ in range(args.epochs):
            order = torch.rand(steps * n, device=device).argsort()
            for k in range(args.minibatches):
                part = order[k * size : (k + 1) * size]
                x, action, before, gain, target = (item[part] for item in flat)
                gain = (gain - gain.mean()) / (gain.std() + 1e-8)
                log_ratio = agent.log_prob(x, action) - before
                ratio = torch.exp(log_ratio)
                policy_loss = -torch.min(ratio * gain, ratio.clamp(1.0 - args.clip, 1.0 + args.clip) * gain).mean()
                loss = policy_loss + 0.5 * ((agent.value(x) - target) ** 2).mean()
                optimizer.zero_grad(set_to_none=False)
                loss.backward()  # type: ignore[no-untyped-call]
                nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
                distance = (ratio - 1.0 - log_ratio).detach().mean()  # Kullback–Leibler divergence from the old policy
                slower, faster = distance > 2.0 * args.kl, distance < 0.5 * args.kl
                factor = 1.0 + 0.5 * faster - slower / 3.0
                lr.copy_((lr * factor).clamp(min=1e-5).minimum(largest_lr))
                optimizer.step()

    start = {name: value.clone() for name, value in agent.state_dict().items()}

    def restart() -> None:
        agent.load_state_dict(start)
        for state in optimizer.state.values():
            for value in state.values():
                value.zero_()

    begin = time.perf_counter()
    for parameter in agent.parameters():
        parameter.grad = torch.zeros_like(parameter)
    rollout, update = graphed(rollout, device, lambda: None), graphed(update, device, restart)
    evaluate()
    report({"compiled": time.perf_counter() - begin})
    begin = last = time.perf_counter()
    done, iteration = 0.0, 0
    while done < args.seconds:
        largest_lr.fill_(args.lr * max(1.0 - done / args.seconds, 0.02))
        rollout()
        update()
        iteration += 1
        if iteration % 4 == 0 and device.type == "cuda":
            torch.cuda.synchronize()  # so that the clock tells the time of the GPU
        done = time.perf_counter() - begin
        if time.perf_counter() - last > args.evaluate_every or done >= args.seconds:
            found = {"seconds": round(done, 2), "steps": iteration * steps * n, **evaluate()}
            report(found)
            last = time.perf_counter()
            if found["survival"] >= args.until:
                break
    return agent


def evaluator(args: argparse.Namespace, agent: Agent) -> Callable[[], dict[str, float]]:
    """Return a function that flies one episode in each of 1,024 rows.

    It returns survival, the share of the time until a fall, and the RMSE (m) of the episodes without one.
    """
    rows = Rows(args, 1024, 1_000_000)
    limit, device, block = rows.env.max_episode_steps, rows.seen.device, 20
    lived = torch.zeros(1024, device=device)
    squares, alive = torch.zeros(1024, device=device), torch.ones(1024, device=device, dtype=torch.bool)

    @torch.no_grad()
    def fly() -> None:
        for _ in range(block):
            _, terminated, _, _, error = rows.step(agent.actor(rows.seen))
            squares.add_((error**2).sum(1))
            alive.logical_and_(~terminated)
            lived.add_(alive)

    def start() -> None:
        first, _ = rows.env.reset(seed=1_000_000) if args.device == "c" else rows.env.reset()
        rows.history.zero_()
        rows.seen.copy_(torch.cat([first, rows.history], 1))
        squares.zero_()
        lived.zero_()
        alive.fill_(True)

    fly = graphed(fly, device, lambda: None)

    def evaluate() -> dict[str, float]:
        start()
        for _ in range(-(-(limit - 1) // block)):
            fly()
        survived = alive.float().mean().item()
        rmse = torch.sqrt(squares[alive].mean() / limit).item() if survived else float("nan")
        share = lived.mean().item() / limit
        return {"survival": round(survived, 4), "lived": round(share, 4), "rmse": round(rmse, 5)}

    return evaluate


if __name__ == "__main__":
    arguments = parse()
    torch.save(train(arguments).state_dict(), arguments.out)
    print(f"Saved: {arguments.out}")
