// Python face of the world: one class `Kernel` for 1 to 8 joints, blocks as flat float64 arrays.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "plant.hpp"

namespace py = pybind11;
using Array = py::array_t<double, py::array::c_style | py::array::forcecast>;

namespace {

constexpr int MOST_JOINTS = 8;

template <int N>
std::unique_ptr<hd_sim::World> make_world(int joints, const double* parameters, const hd_sim::Options& options) {
    if (joints == N) return std::make_unique<hd_sim::Plant<N>>(parameters, options);
    if constexpr (N < MOST_JOINTS) return make_world<N + 1>(joints, parameters, options);
    throw std::invalid_argument("the world has 1 to 8 joints");
}

using Fields = std::vector<hd::Field>;

const Fields& fields_of(const std::string& name) {
    if (name == "PlantParameters") return hd_sim::Parameters<2>::fields();
    if (name == "PlantState") return hd_sim::State<2>::fields();
    if (name == "PlantSample") return hd_sim::PlantSample::fields();
    return hd_sim::PlantTruth::fields();
}

class Kernel {
  public:
    Kernel(int joints, const Array& parameters, double dt, int substeps, int reported_delay, bool first_order,
           bool accounts, const std::vector<std::uint64_t>& keys)
        : joints_(joints) {
        check(parameters, size_of("PlantParameters"), "parameters");
        if (!(dt > 0.0) || substeps < 1) throw std::invalid_argument("dt and substeps must be positive");
        if (reported_delay < 0 || reported_delay > 16)
            throw std::invalid_argument("reported_delay must be 0 to 16 ticks");
        if (keys.size() != hd_sim::STREAMS) throw std::invalid_argument("expected one noise key for each stream");
        hd_sim::Options options;
        options.dt = dt;
        options.substeps = substeps;
        options.reported_delay = reported_delay;
        options.first_order = first_order;
        options.accounts = accounts;
        std::copy(keys.begin(), keys.end(), options.keys);
        world_ = make_world<1>(joints, parameters.data(), options);
    }

    Array state() const {
        return filled("PlantState", [this](double* to) { world_->write_state(to); });
    }
    Array sample() {
        return filled("PlantSample", [this](double* to) { world_->sample(to); });
    }
    Array truth() {
        return filled("PlantTruth", [this](double* to) { world_->truth(to); });
    }
    void advance() { world_->advance(); }
    void brake(bool engage) { world_->brake(engage); }

    void restore(const Array& state) {
        check(state, size_of("PlantState"), "state");
        world_->read_state(state.data());
    }
    void latch(const Array& command) {
        check(command, joints_, "command");
        world_->latch(command.data());
    }
    void step(const Array& command) {
        latch(command);
        advance();
    }
    void start(const Array& pose, const Array& torque, bool motor_side) {
        check(pose, joints_, "pose");
        check(torque, joints_, "torque");
        world_->start(pose.data(), torque.data(), motor_side);
    }
    void external(const Array& joint_torque, const Array& motor_torque) {
        check(joint_torque, joints_, "joint_torque");
        check(motor_torque, joints_, "motor_torque");
        world_->external(joint_torque.data(), motor_torque.data());
    }

    // One tick per row of `commands`; sample i is read after command i is latched, before the tick is advanced.
    py::tuple step_many(const Array& commands, bool samples, bool truths) {
        if (commands.ndim() != 2 || commands.shape(1) != joints_)
            throw std::invalid_argument("commands: expected (ticks, joints)");
        const py::ssize_t ticks = commands.shape(0);
        const py::ssize_t width = size_of("PlantSample"), depth = size_of("PlantTruth");
        Array seen({samples ? ticks : 0, width}), real({truths ? ticks : 0, depth});
        double *sample_to = seen.mutable_data(), *truth_to = real.mutable_data();
        const double* from = commands.data();
        {
            py::gil_scoped_release released;
            for (py::ssize_t k = 0; k < ticks; ++k) {
                world_->latch(from + k * joints_);
                if (samples) world_->sample(sample_to + k * width);
                if (truths) world_->truth(truth_to + k * depth);
                world_->advance();
            }
        }
        return py::make_tuple(seen, real);
    }

    py::tuple accelerate(const Array& q, const Array& w, const Array& torque, const Array& armature) {
        for (const Array* each : {&q, &w, &torque, &armature}) check(*each, joints_, "argument");
        Array acceleration(joints_), bias(joints_), inertia({joints_, joints_});
        world_->accelerate(q.data(), w.data(), torque.data(), armature.data(), acceleration.mutable_data(),
                           inertia.mutable_data(), bias.mutable_data());
        return py::make_tuple(acceleration, inertia, bias);
    }

    // For the drive side, which stands between the controller and this world.
    py::capsule world() { return py::capsule(world_.get(), hd_sim::kWorldCapsule); }
    py::ssize_t size_of(const char* block) const {
        return static_cast<py::ssize_t>(hd::block_size(fields_of(block), joints_));
    }

  private:
    template <class Fill>
    Array filled(const char* block, Fill fill) const {
        Array out(size_of(block));
        fill(out.mutable_data());
        return out;
    }

    static void check(const Array& array, py::ssize_t size, const char* name) {
        if (array.ndim() != 1 || array.size() != size) {
            throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(size) + " numbers, got " +
                                        std::to_string(array.size()));
        }
    }

    int joints_;
    std::unique_ptr<hd_sim::World> world_;
};

}  // namespace

PYBIND11_MODULE(_plant, m) {
    m.doc() = "Compiled harmonic-drive plant: drives, rigid arm and sensors.";
    py::dict blocks;
    for (const char* name : {"PlantParameters", "PlantState", "PlantSample", "PlantTruth"}) {
        py::list list;
        for (const hd::Field& field : fields_of(name))
            list.append(py::make_tuple(field.name, field.per_joint, field.unit, field.meaning));
        blocks[name] = list;
    }
    m.attr("BLOCKS") = blocks;
    m.attr("NOISE_STREAMS") = py::make_tuple("gauge_bridge", "resolver", "sampling_jitter");
    py::class_<Kernel>(m, "Kernel")
        .def(py::init<int, const Array&, double, int, int, bool, bool, const std::vector<std::uint64_t>&>(),
             py::arg("joints"), py::arg("parameters"), py::arg("dt"), py::arg("substeps"), py::arg("reported_delay"),
             py::arg("first_order"), py::arg("accounts"), py::arg("keys"))
        .def("state", &Kernel::state)
        .def("restore", &Kernel::restore)
        .def("start", &Kernel::start)
        .def("latch", &Kernel::latch)
        .def("advance", &Kernel::advance)
        .def("step", &Kernel::step)
        .def("step_many", &Kernel::step_many)
        .def("sample", &Kernel::sample)
        .def("truth", &Kernel::truth)
        .def("brake", &Kernel::brake)
        .def("external", &Kernel::external)
        .def("accelerate", &Kernel::accelerate)
        .def("world", &Kernel::world);
}
