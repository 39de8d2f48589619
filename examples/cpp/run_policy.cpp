// Runs an exported policy from C++: reads what the file says of itself, reproduces its golden pairs, builds the
// observation from measurements and prints joint targets.
//
//     run_policy robot.onnx [state.json]
//
// It does one step. It has none of the Python controller's checks (docs/deployment.md, "Limits and watchdog"): a robot
// needs those too. Run `arrive verify` on the file first; it finds damage that this program does not look for.

#include <onnxruntime_cxx_api.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>
#include <vector>

using Json = nlohmann::json;
using Vector = std::vector<double>;
using Vec3 = std::array<double, 3>;

// Measurements and command of a robot. World: level, z up. Base: x forward, y left, z up.
struct State {
  Vector joint_pos, joint_vel;               // in the order of the file's joint names [rad, rad/s]
  Vec3 base_pos_w;                           // [m]
  std::array<double, 4> base_quat_w;         // unit quaternion (w, x, y, z), rotates base into world
  Vec3 base_lin_vel_b, base_ang_vel_b;       // [m/s, rad/s]
  Vec3 target_w;                             // where the base is to be [m]
  double time_left_s;                        // until then [s]
  Vector action;                             // the network's last output, zeros at first
  Vector heights_w;                          // ground at the grid's points, in the file's order [m]
};

struct Policy {
  Ort::Session session;
  Json robot, observation, heights, task, golden;
};

Json section(const Ort::Session& session, const std::string& name) {
  Ort::AllocatorWithDefaultOptions allocator;
  const auto text = session.GetModelMetadata().LookupCustomMetadataMapAllocated(("arrive." + name).c_str(), allocator);
  if (!text) throw std::runtime_error("the file lacks the metadata arrive." + name + ": is it an export of arrive?");
  return Json::parse(text.get());
}

Policy read_policy(Ort::Env& env, const std::string& path) {
  Ort::SessionOptions options;
  options.SetIntraOpNumThreads(1);  // threads cost more than they save at this size
  Ort::Session session(env, path.c_str(), options);
  Json robot = section(session, "robot"), observation = section(session, "observation");
  Json heights = section(session, "heights"), task = section(session, "task"), golden = section(session, "golden");
  return {std::move(session), robot, observation, heights, task, golden};
}

std::vector<float> act(Policy& policy, std::vector<float> observation) {
  const auto memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
  const std::array<int64_t, 2> shape{1, static_cast<int64_t>(observation.size())};
  const auto input =
      Ort::Value::CreateTensor<float>(memory, observation.data(), observation.size(), shape.data(), shape.size());
  const char* const inputs[] = {"observation"};
  const char* const outputs[] = {"action"};
  const auto result = policy.session.Run(Ort::RunOptions{}, inputs, &input, 1, outputs, 1);
  const float* first = result[0].GetTensorData<float>();
  return {first, first + result[0].GetTensorTypeAndShapeInfo().GetElementCount()};
}

// Largest difference between the network's output here and where it was exported.
double golden_error(Policy& policy) {
  const auto inputs = policy.golden.at("observations").get<std::vector<std::vector<float>>>();
  const auto expected = policy.golden.at("actions").get<std::vector<std::vector<float>>>();
  double worst = 0.0, largest = 1.0;
  for (size_t i = 0; i < inputs.size(); ++i) {
    const auto found = act(policy, inputs[i]);
    for (size_t j = 0; j < expected.at(i).size(); ++j) {
      worst = std::max(worst, std::abs(static_cast<double>(found.at(j)) - expected[i][j]));
      largest = std::max(largest, std::abs(static_cast<double>(expected[i][j])));
    }
  }
  return worst / largest;
}

// A vector of the world in the base frame: the transposed rotation matrix of the quaternion times the vector.
Vec3 to_base(const std::array<double, 4>& quat, const Vec3& v) {
  const auto [w, x, y, z] = quat;
  return {
      (1 - 2 * (y * y + z * z)) * v[0] + 2 * (x * y + w * z) * v[1] + 2 * (x * z - w * y) * v[2],
      2 * (x * y - w * z) * v[0] + (1 - 2 * (x * x + z * z)) * v[1] + 2 * (y * z + w * x) * v[2],
      2 * (x * z + w * y) * v[0] + 2 * (y * z - w * x) * v[1] + (1 - 2 * (x * x + y * y)) * v[2],
  };
}

// The same the other way round: the quaternion of the inverse rotation has the opposite axis.
Vec3 to_world(const std::array<double, 4>& quat, const Vec3& v) {
  return to_base({quat[0], -quat[1], -quat[2], -quat[3]}, v);
}

// A foot in the base frame: from where it is with all joint positions 0, turned about one joint after the other, the
// last of the leg first.
Vec3 foot_in_base(const Policy& policy, const Json& foot, const Vector& joint_pos) {
  const auto names = policy.robot.at("joint_names").get<std::vector<std::string>>();
  const auto& links = foot.at("links");
  Vec3 place = foot.at("foot_m");
  for (auto link = links.rbegin(); link != links.rend(); ++link) {
    const auto joint = std::find(names.begin(), names.end(), link->at("joint").get<std::string>()) - names.begin();
    const double sin = std::sin(joint_pos.at(joint) / 2), cos = std::cos(joint_pos.at(joint) / 2);
    const Vec3 axis = link->at("axis"), pos = link->at("pos_m");
    for (size_t i = 0; i < 3; ++i) place[i] -= pos[i];
    place = to_world({cos, sin * axis[0], sin * axis[1], sin * axis[2]}, place);
    for (size_t i = 0; i < 3; ++i) place[i] += pos[i];
  }
  return place;
}

// Number of grid points along y, and how far ground at one of them lies below the point that heights are relative to.
size_t grid_columns(const Json& points) {
  const auto in_first_row = [&](const Json& point) { return point.at(0) == points.at(0).at(0); };
  return std::count_if(points.begin(), points.end(), in_first_row);
}

double below(const Policy& policy, const State& state, size_t point) {
  const auto& clip = policy.heights.at("clip_m");
  const double offset = policy.heights.at("offset_m");
  return std::clamp<double>(state.base_pos_w[2] - offset - state.heights_w.at(point), clip.at(0), clip.at(1));
}

// Heights at the grid's points nearest to places around each foot, which are given in the heading frame.
Vector foot_heights(const Policy& policy, const State& state) {
  const Json& points = policy.heights.at("points_m");
  const double step = policy.heights.at("step_m"), low_x = points.at(0).at(0), low_y = points.at(0).at(1);
  const size_t columns = grid_columns(points), rows = points.size() / columns;
  const Vec3 forward = to_world(state.base_quat_w, {1.0, 0.0, 0.0});
  const double yaw = std::atan2(forward[1], forward[0]);
  const auto cell = [step](double place, double low, size_t count) {
    return static_cast<size_t>(std::clamp(std::nearbyint((place - low) / step), 0.0, count - 1.0));
  };
  Vector heights;
  for (const auto& foot : policy.robot.at("feet")) {
    const Vec3 at = to_world(state.base_quat_w, foot_in_base(policy, foot, state.joint_pos));
    const double x = std::cos(yaw) * at[0] + std::sin(yaw) * at[1], y = std::cos(yaw) * at[1] - std::sin(yaw) * at[0];
    for (const auto& place : policy.heights.at("foot_points_m")) {
      const double dx = place.at(0), dy = place.at(1);
      heights.push_back(below(policy, state, cell(x + dx, low_x, rows) * columns + cell(y + dy, low_y, columns)));
    }
  }
  return heights;
}

Vector to_vector(const Vec3& v) { return {v.begin(), v.end()}; }

// One slice of the observation before it is scaled.
Vector term(const std::string& name, const Policy& policy, const State& state) {
  if (name == "base_lin_vel") return to_vector(state.base_lin_vel_b);
  if (name == "base_ang_vel") return to_vector(state.base_ang_vel_b);
  if (name == "gravity") return to_vector(to_base(state.base_quat_w, {0.0, 0.0, -1.0}));
  if (name == "target") {
    Vec3 way{};
    for (size_t i = 0; i < 3; ++i) way[i] = state.target_w[i] - state.base_pos_w[i];
    return to_vector(to_base(state.base_quat_w, way));
  }
  if (name == "time_left") return {std::min(state.time_left_s, policy.task.at("episode_s").get<double>())};
  if (name == "joint_pos") {
    Vector offset = state.joint_pos;
    const auto rest = policy.robot.at("default_joint_pos_rad").get<Vector>();
    for (size_t i = 0; i < offset.size(); ++i) offset[i] -= rest.at(i);
    return offset;
  }
  if (name == "joint_vel") return state.joint_vel;
  if (name == "action") return state.action;
  if (name == "foot_heights") return foot_heights(policy, state);
  if (name == "heights") {
    const Json& points = policy.heights.at("points_m");
    const size_t samples = policy.heights.value("samples", 1);  // points per side of a height's square
    const size_t columns = grid_columns(points);
    Vector mean(points.size() / (samples * samples), 0.0);
    for (size_t i = 0; i < points.size(); ++i) {
      const size_t row = i / columns / samples, column = i % columns / samples;
      mean.at(row * (columns / samples) + column) += below(policy, state, i) / (samples * samples);
    }
    return mean;
  }
  throw std::runtime_error("this program cannot provide the observation " + name);
}

std::vector<float> observe(const Policy& policy, const State& state) {
  std::vector<float> observation;
  for (const auto& row : policy.observation) {
    const auto values = term(row.at("name"), policy, state);
    if (values.size() != row.at("stop").get<size_t>() - row.at("start").get<size_t>())
      throw std::runtime_error("wrong number of values for the observation " + row.at("name").get<std::string>());
    for (const double value : values) observation.push_back(static_cast<float>(value * row.at("scale").get<double>()));
  }
  return observation;
}

// A figure of each joint: the file has a list, or one number for all.
Vector per_joint(const Policy& policy, const std::string& name) {
  const auto& value = policy.robot.at(name);
  return value.is_array() ? value.get<Vector>() : Vector(policy.robot.at("joint_names").size(), value.get<double>());
}

// Default pose + scale * action, cut to what the effort limit allows and then to the joints' ranges.
Vector joint_targets(const Policy& policy, const State& state, const std::vector<float>& action) {
  const auto rest = policy.robot.at("default_joint_pos_rad").get<Vector>();
  const auto limits = policy.robot.at("joint_limits_rad").get<std::vector<Vector>>();
  const double scale = policy.robot.at("action_scale_rad");
  const auto stiffness = per_joint(policy, "stiffness"), damping = per_joint(policy, "damping");
  const auto effort = per_joint(policy, "effort_limit");
  Vector targets;
  for (size_t i = 0; i < rest.size(); ++i) {
    const double reach = effort.at(i) / stiffness.at(i), lag = damping.at(i) / stiffness.at(i);
    const double centre = state.joint_pos.at(i) + lag * state.joint_vel.at(i);
    const double target = std::clamp(rest[i] + scale * action.at(i), centre - reach, centre + reach);
    targets.push_back(std::clamp(target, limits.at(i).at(0), limits.at(i).at(1)));
  }
  return targets;
}

// A robot that stands on flat ground and is to be 2 m ahead in 4 s.
State standing(const Policy& policy) {
  const double height = policy.robot.at("standing_height_m");
  const size_t joints = policy.robot.at("joint_names").size();
  return {policy.robot.at("default_joint_pos_rad").get<Vector>(),
          Vector(joints, 0.0),
          {0.0, 0.0, height},
          {1.0, 0.0, 0.0, 0.0},
          {},
          {},
          {2.0, 0.0, policy.task.at("target_height_m")},
          4.0,
          Vector(joints, 0.0),
          Vector(policy.heights.at("points_m").size(), 0.0)};
}

State read_state(const std::string& path) {
  const Json json = Json::parse(std::ifstream(path));
  return {json.at("joint_pos"),      json.at("joint_vel"),      json.at("base_pos_w"), json.at("base_quat_w"),
          json.at("base_lin_vel_b"), json.at("base_ang_vel_b"), json.at("target_w"),   json.at("time_left_s"),
          json.at("action"),         json.at("heights_w")};
}

int main(int count, char** arguments) try {
  if (count < 2 || count > 3) throw std::runtime_error("usage: run_policy robot.onnx [state.json]");
  Ort::Env env(ORT_LOGGING_LEVEL_ERROR, "arrive");
  Policy policy = read_policy(env, arguments[1]);
  const double error = golden_error(policy);
  if (!(error <= 1e-5)) throw std::runtime_error("golden actions differ by " + std::to_string(error));
  std::printf("%zu golden pairs met, largest difference %.1e\n", policy.golden.at("actions").size(), error);
  const State state = count == 3 ? read_state(arguments[2]) : standing(policy);
  const auto targets = joint_targets(policy, state, act(policy, observe(policy, state)));
  for (size_t i = 0; i < targets.size(); ++i)
    std::printf("%s %.9f\n", policy.robot.at("joint_names").at(i).get<std::string>().c_str(), targets[i]);
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "run_policy: %s\n", error.what());
  return 1;
}
