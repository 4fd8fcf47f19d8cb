// The worlds as Madrona's entities. Moving bodies have an archetype of their own, the columns of which are exported.
//
// This file and worlds.cpp are compiled twice: by the C++ compiler for the CPU, and by NVRTC for a GPU when a simulation
// starts. They know neither Python nor the standard library.
#pragma once

#include <madrona/custom_context.hpp>
#include <madrona/physics.hpp>
#include <madrona/taskgraph_builder.hpp>

namespace gsb {

class Engine;

enum class Graph : uint32_t { Begin, Step, Count };

enum class Column : uint32_t { Position, Rotation, Velocity, Count };

struct Moving : madrona::Archetype<madrona::phys::RigidBody> {};
struct Fixed : madrona::Archetype<madrona::phys::RigidBody> {};

// A body as it begins, in memory of the device that simulates.
struct Start {
    madrona::math::Vector3 position;
    madrona::math::Quat rotation;
    madrona::phys::Velocity velocity;
    int32_t object;  // its row in the ObjectManager
    int32_t moves;   // 0 or 1
};

struct World : madrona::WorldBase {
    struct Config {
        madrona::phys::ObjectManager *objects;
        const Start *starts;
        int32_t bodies;
        int32_t substeps;
        float deltaT;
        madrona::math::Vector3 gravity;
    };

    struct Init {};

    static void registerTypes(madrona::ECSRegistry &registry, const Config &config);
    static void setupTasks(madrona::TaskGraphManager &graphs, const Config &config);

    World(Engine &ctx, const Config &config, const Init &);
};

class Engine : public madrona::CustomContext<Engine, World> {
public:
    using CustomContext::CustomContext;
};

}
