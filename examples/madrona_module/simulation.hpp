// All worlds of a scene on a CPU or a GPU, without Python and without a header of Madrona.
#pragma once

#include "scene.hpp"

#include <memory>

namespace gsb {

class Simulation {
public:
    Simulation(const Scene &scene, const Settings &settings);  // std::invalid_argument where it cannot be simulated
    ~Simulation();

    void step();  // returns when the device is done

    // Memory of the device that steps change, float32.
    float *positions() const;   // [world, moving body, 3]
    float *rotations() const;   // [world, moving body, 4]
    float *velocities() const;  // [world, moving body, 6]

    struct Device;

private:
    std::unique_ptr<Device> device_;
};

}
