"""Train an agent: environment and learner each in their own process, on two cores.

    modpush train cpu --out runs/train            # the first part of `make train`, some tens of minutes
    modpush train cpu --out runs/train --resume   # continue after an interrupt
    modpush train refine --init-from runs/train --out runs/refine   # the second part: more careful
    modpush train smoke --out /tmp/smoke          # everything once, in some seconds
    modpush train cpu --out runs/rays --train.env.encoder rays --train.seed 1
    modpush train cpu --out runs/more --init-from runs/train   # start from another run's weights
    modpush train cpu --out runs/calm --reward-term my_lab:large_actions 0.2   # your own term
    modpush train cpu --out runs/wide --collector ray --num-collectors 8   # on a Ray cluster

The folder gets `config.yaml`, `log.csv`, `evaluations.csv` (greedy, on held-out episodes),
`curve.png`, `best_agent.safetensors` (give it to `modpush.load_agent` or `modpush evaluate --policy`),
`checkpoints/`, and the files of TensorBoard in `logs/`. Ctrl-C, SIGTERM and SIGHUP write a checkpoint
and stop.

Presets:
  cpu                The configuration that learns soonest on two CPU cores, in some tens of minutes.
  any_object         The same with twelve objects, eight of them of random shape, and random mass and
                     friction.
  refine             Further training of a run of `cpu`, with higher weights for contact, collisions
                     and detours.
  refine_any_object  The same for a run of `any_object`.
  paper              The paper's configuration: 7e6 steps with one update each, which takes days on a
                     CPU.
  paper_cpu          The paper's observation, planner, replay, curriculum and penalties, and what it
                     takes to learn with them on two CPU cores, in an hour and a half.
  pose               Goals with orientation in free space, for a box of 10 x 5 cm, in some twenty
                     minutes of one core.
  pose_any_object    The same for eight shapes, whose mass, friction and centre of mass are drawn for
                     each episode.
  pose_obstacles     Goals with orientation past one or two obstacles that stand or move, for the same
                     box.
  refine_pose_obstacles
                     Further training of a run of `pose_obstacles`, with an obstacle in the way and
                     higher weights for collisions.
  smoke              A run of a few seconds that does everything once and learns nothing.

The defaults of the options that begin with `--train.` are the preset's. NAME may be "module:name",
for a part of your own.

Run:
  --out FOLDER                        Folder of the run; by default runs/train_PRESET.
  --resume                            Continue the run in the folder from its newest checkpoint.
  --config FILE                       YAML file of settings that replace the preset's, such as another
                                      run's config.yaml; the options below replace the file's.
  --allow MODULE ...                  Modules from which this file may import its author's own parts.
  --init-from AGENT                   Start from the weights of a shipped agent, an agent's file, a
                                      run's folder or a checkpoint.
  --minutes X                         Training time after which the run ends like a completed one.
  --train.total-steps N               Environment steps after which the run ends.
  --train.seed N                      Seed of everything that is drawn at random.
  --threads N                         Number of torch's threads in the learner's process.
  --collector {local,ray}             With "ray" the scenes act on a Ray cluster,
  --num-collectors N                  in so many collectors.
  --train.evaluate-every N            Environment steps between evaluations on held-out episodes.
  --train.loggers csv tensorboard     TorchRL loggers that are written to.

Environment:
  --train.env.num-envs N              Number of scenes stepped together.
  --train.env.scenario.scene NAME ... Scene families, one of which is drawn for each episode.
  --train.env.scenario.pushed-object NAME ...  Objects, one of which is drawn for each episode;
                                      random_7 has a random shape.
  --train.env.scenario.randomize-dynamics  Draw the object's mass, friction and centre of mass.
  --train.env.simulation.engine NAME  Physics engine: sapien, mujoco, or module:name.
  --train.env.simulation.robot NAME  Arm: ur5, ur10, ... or module:name.
  --train.env.simulation.tool NAME  Tool of the arm: 2f85 (the closed gripper), rod, or module:name.
  --train.env.planner NAME            distance_field, lazy_theta_star_grid, lazy_theta_star, a_star or
                                      straight_line.
  --train.env.inflation INFLATION     How far obstacles are inflated for planning: circumscribed,
                                      inscribed, widest, or a distance [m].
  --train.env.encoder NAME            Encoder of the local window: vae, rays, none, end_to_end (trained
                                      with the agent), or a file of a DepthVAE.
  --train.env.frame {base,object,path}  Axes of the observation and of the local window.
  --train.env.add NAME ...            Entries to add to the observation.
  --train.env.leave-out NAME ...      Entries to leave out of it.
  --reward-term NAME WEIGHT ...       Your own reward terms, with their weights.
  --train.env.reward.weights.TERM X   Weight of one of the preset's reward terms.

Learner (TQC) and replay buffer:
  --train.tqc.loss NAME               tqc, sac or td3.
  --train.tqc.hidden-sizes N ...      Widths of the hidden layers of the actor and of each critic.
  --train.tqc.actor-lr X              Learning rate of the actor; also --train.tqc.critic-lr and
                                      --train.tqc.alpha-lr.
  --train.tqc.gamma X                 Discount factor per step.
  --train.tqc.batch-size N            Number of transitions in each update; set it together with
  --train.replay.batch-size N         the number of transitions in each sample.
  --train.tqc.updates-per-step X      Number of updates per environment step.
  --train.tqc.learning-starts N       Environment steps before the first update.
  --train.replay.sampler NAME         attentive, uniform or prioritized.
  --train.replay.n-steps N            Number of steps whose rewards are summed before bootstrapping.
  --train.replay.capacity N           Number of transitions that the buffer holds.
  --train.no-mirror                   Do not learn from mirror images.
  --train.curriculum.promotion {success,steps,off}  When the next stage of the curriculum begins.

Every other field of `TrainConfig` is an option in the same way, such as `--train.tqc.tau 0.01`.
docs/train_options.md lists all of them with their defaults, and the settings of each preset.
"""

from collections.abc import Sequence

from modpush.cli.training_run import run_preset

__all__ = ["main"]


def main(arguments: Sequence[str]) -> None:
    """`modpush train <arguments>`."""
    run_preset(arguments)
