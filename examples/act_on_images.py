"""Load a trained method and let it act on images; run this at the top of the repository."""

import elast_cli as elast
from elast_cli.envs.registry import make, scenarios


def main(where="docs/results/models/artifacts/block-asym/policy/v1", **options):
    agent = elast.load(where, **options)
    robot = make("block-asym")  # stands for anything with a camera: the agent sees frames alone
    scenario = scenarios("block-asym", "upstream", seed=0, count=1)[0]
    frame, info = robot.reset(options={"scenario": scenario})
    print(agent.plan(frame, info["goal"]).outcome.text)
    agent.begin(info["goal"])
    while not info["success"]:
        frame, _, _, _, info = robot.step(agent.act(frame))
    return agent


if __name__ == "__main__":
    main()
