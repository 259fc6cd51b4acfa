/* A rig's physics for the studies, written from the descriptions of its effects alone, independent of the project's kernel.
 *
 * All quantities are normalised by the rig's own scales (w = speed / full speed, b = (pitch + offset) / span, T = thrust / full
 * thrust), time in s. Everything moves by small explicit steps. `struct rig` is put before this text by physics.py, one double a
 * field: `step` [s] of the integration, `slow`, how many times slower than the paper's rig this one is, `full` speed [rpm], lags,
 * map, and options; an option that is 0 is off.
 */
#include <math.h>
#include <stdlib.h>

#define PREROLL 2.0 /* s on the paper's rig: the first command is held for so long before the record begins, at t = 0 */

static double clip(double v, double low, double high) { return v < low ? low : v > high ? high : v; }

static double sign(double v) { return (v > 0.0) - (v < 0.0); }

/* A command `delay` seconds ago; row r holds from r * sub steps on. Between steps it is weighed by its share of the step. */
static double late(const struct rig *r, const double *command, long step, long sub, double delay) {
    double back = delay / r->step, whole = floor(back), share = back - whole;
    long now = step - (long)whole, before = now - 1;
    double a = command[now < 0 ? 0 : now / sub], b = command[before < 0 ? 0 : before / sub];
    return share > 0.0 ? (1.0 - share) * a + share * b : a;
}

struct state {
    double held, led, heat, x, b, play, active, timer, latched, before;
    double y, w, spin, trail, push, inflow, slow, creep[4], cell, cell_rate, load, stalled;
    double worn, twisted, drained, esc, stuck, parted, w_before, started; /* of effects in no list */
};

/* Rate of the actuator's stage that carries the nonlinear effects: from error e and time constant tau. */
static double actuator(const struct rig *r, struct state *s, double e, double tau) {
    double v, size = fabs(e), left = size > r->deadzone ? sign(e) * (size - r->deadzone) : 0.0;
    if (r->pitch_asym != 0.0) tau *= exp(e > 0.0 ? r->pitch_asym : -r->pitch_asym);
    v = left / tau;
    if (r->stop_band > 0.0 && size <= r->stop_band) v = 0.0;
    if (r->restart > 0.0) {
        if (size <= r->stop) s->active = 0.0;
        if (size > r->restart) s->active = 1.0;
        if (s->active < 0.5) v = 0.0;
    }
    if (r->speed_max > 0.0) v = size > 0.003 ? sign(e) * fmin(clip(size / tau, r->speed_min, r->speed_max), size / r->step) : 0.0;
    if (r->rate > 0.0) v = clip(v, -r->rate, r->rate);
    if (r->stall_time > 0.0) {
        if (s->latched != 0.0 && sign(e) != s->latched) s->latched = 0.0;
        if (s->latched == 0.0) {
            s->timer = fabs(v) < r->stall_speed && size > r->stall_band ? s->timer + r->step : 0.0;
            if (s->timer > r->stall_time) s->latched = sign(e), s->timer = 0.0;
        }
        if (s->latched != 0.0) v = 0.0;
    }
    return v;
}

static double pitch(const struct rig *r, struct state *s, const double *command, long step, long sub, double warm) {
    double u = late(r, command, step, sub, r->pitch_delay), e, tau_1 = r->tau_b1 * warm, tau_2 = r->tau_b2 * warm;
    if (r->late_up != 0.0) {
        double other = late(r, command, step, sub, fabs(r->late_up));
        u = r->late_up > 0.0 ? fmin(u, other) : fmax(u, other);
    }
    if (r->deadband > 0.0) {
        if (fabs(u - s->held) > r->deadband) s->held = u;
        u = s->held;
    }
    if (r->pitch_step > 0.0) u = r->pitch_step * floor(u / r->pitch_step + 0.5);
    if (r->travel_max > 0.0 && r->travel_stop < 0.5) u = fmin(u, r->travel_max);
    if (r->slew > 0.0) u = s->led += clip(u - s->led, -r->slew * r->step, r->slew * r->step);
    e = u - s->x;
    if (r->servo_load > 0.0) tau_1 *= 1.0 + r->servo_load * fmax(s->load - 0.25, 0.0); /* loaded, the servo is slower */
    s->x += r->step * (r->last_stage > 0.5 ? e / tau_1 : actuator(r, s, e, tau_1));
    e = s->x - s->b;
    if (r->torsion != 0.0) e -= r->torsion * s->load;
    if (r->friction > 0.0) { /* Stribeck: breaks loose above `friction`, then slides against 0.4 of it and less with speed */
        double speed = r->slow * fabs(s->before), moving = speed > 1e-4;
        double drag = moving > 0.5 ? r->friction * (0.4 + 0.6 * exp(-speed * speed / 0.01)) : r->friction;
        s->before = fabs(e) > drag ? sign(e) * (fabs(e) - drag) / tau_2 : 0.0;
        s->b += r->step * s->before;
    } else
        s->b += r->step * (r->last_stage > 0.5 ? actuator(r, s, e, tau_2) : e / tau_2);
    if (r->travel_max > 0.0) s->b = fmin(s->b, r->travel_max);
    s->play = fmin(fmax(s->play, s->b - r->backlash), s->b + r->backlash);
    if (r->gear > 0.0) return s->play + r->gear * sin(2.0 * M_PI * s->play / r->gear_pitch); /* an eccentric wheel */
    return s->play;
}

/* Time constant of a rotor's lag on its way from `at` to `to`. */
static double bent_tau(const struct rig *r, double tau, double to, double at) {
    tau *= exp(to > at ? r->speed_asym : -r->speed_asym);
    return tau / fmax(1.0 + r->damping * (at - 2.0 / 3.0), 0.2);
}

static double rotor(const struct rig *r, struct state *s, const double *command, long step, long sub, double b, double volt) {
    double u = late(r, command, step, sub, r->speed_delay), tau = r->tau_w1, v, dip;
    if (r->speed_max_w > 0.0) u = fmin(u, r->speed_max_w - r->sag * b);
    if (r->volt_gain > 0.0) u = fmin(u, r->volt_gain * volt);
    u *= 1.0 + r->volt_share * (volt - 1.0);
    if (r->esc_step > 0.0) { /* the speed controller passes on changes above a threshold */
        if (fabs(u - s->esc) > r->esc_step) s->esc = u;
        u = s->esc;
    }
    if (r->drain > 0.0) { /* the battery's voltage sinks as it is loaded, and comes back */
        s->drained += r->step * (s->load - s->drained) / r->drain_time;
        u *= 1.0 - r->drain * s->drained;
    }
    u -= r->droop * fmax(b, 0.0) * s->w * s->w;
    v = (u - s->y) / (r->speed_last > 0.5 ? tau : bent_tau(r, tau, u, s->y));
    if (r->ramp > 0.0) v = clip(v, -r->ramp, r->ramp);
    if (r->torque > 0.0) v = fmin(v, r->torque - r->torque_load * s->load); /* the motor's current limit */
    if (r->coast > 0.0) v = fmax(v, -r->coast * s->w * s->w);               /* no brake: the air alone slows it */
    s->y += r->step * v;
    if (r->hunt_hz > 0.0) { /* the loop's second pole becomes an underdamped pair */
        double p = 2.0 * M_PI * r->hunt_hz;
        s->spin += r->step * (p * p * (s->y - s->w) - 2.0 * r->hunt_zeta * p * s->spin);
        s->w += r->step * s->spin;
    } else
        s->w += r->step * (s->y - s->w) / (r->speed_last > 0.5 ? bent_tau(r, r->tau_w2, s->y, s->w) : r->tau_w2);
    if (r->coupling == 0.0) return s->w;
    dip = (b - s->trail) / r->tau_w1;
    s->trail += r->step * dip;
    s->push += r->step * (dip - s->push) / r->tau_w2;
    return s->w - r->coupling * (r->coupling_stiff > 0.5 ? dip : s->push);
}

static double thrust(const struct rig *r, struct state *s, double w, double b, double rate, double t) {
    if (r->untwist != 0.0) { /* centrifugal force untwists the blade, which gives way slowly */
        s->twisted += r->step * (w * w - s->twisted) / r->untwist_time;
        b -= r->untwist * s->twisted;
    }
    double T = w * (w * (r->c20 + r->c21 * b + r->c30 * w) + b * (r->c11 + r->c12 * b)), steady;
    T += r->map_w * w + r->map_w2b2 * w * w * b * b + r->map_wb3 * w * b * b * b;
    if (r->stall > 0.0) {
        double angle = b - 0.45 * w;
        if (angle > 0.45) s->stalled = 1.0;
        if (angle < 0.2) s->stalled = 0.0;
        T *= 1.0 - r->stall * s->stalled;
    }
    steady = T;
    if (r->fade_load > 0.5) {
        s->heat += r->step * (steady - s->heat) / r->fade_time;
        T *= 1.0 + r->fade * s->heat;
    } else if (r->fade != 0.0)
        T *= 1.0 + r->fade * (r->fade_time > 0.0 ? 1.0 - exp(-t / r->fade_time) : t / 100.0);
    if (r->inflow != 0.0) {
        s->inflow += r->step * (b - s->inflow) / r->inflow_time;
        T += r->inflow * w * w * (b - s->inflow);
    }
    T += r->feedthrough * w * w * rate;
    if (r->notch > 0.0) T *= 1.0 - r->notch * exp(-pow((w - 0.68) / 0.06, 2.0)); /* the stand's wake blocks at one speed */
    if (r->parting > 0.0) { /* the flow parts under load and comes back late */
        if (T > 0.5) s->parted = 1.0;
        if (T < 0.3) s->parted = 0.0;
        T *= 1.0 - r->parting * s->parted;
    }
    if (r->surge != 0.0) { /* air and mount are pushed as the rotor speeds up */
        if (s->started > 0.5) T += r->surge * (w - s->w_before) / r->step;
        s->w_before = w, s->started = 1.0;
    }
    if (r->wash != 0.0) {
        s->slow += r->step * (steady - s->slow) / r->wash_time;
        T -= r->wash * s->slow;
    }
    s->load += r->step * (steady - s->load) / (0.02 * r->slow);
    return T;
}

static double cell(const struct rig *r, struct state *s, double T, double t) {
    static const double times[4] = {0.3, 1.5, 7.0, 35.0};
    double reading = T;
    if (r->ring_hz > 0.0) {
        double p = 2.0 * M_PI * r->ring_hz;
        s->cell_rate += r->step * (p * p * (T - s->cell) - 2.0 * r->ring_zeta * p * s->cell_rate);
        reading = s->cell += r->step * s->cell_rate;
    } else if (r->cell_time > 0.0)
        reading = s->cell += r->step * (T - s->cell) / r->cell_time;
    for (int k = 0; k < 4 && r->creep != 0.0; k++) {
        s->creep[k] += r->step * (T - s->creep[k]) / times[k];
        reading += 0.25 * r->creep * s->creep[k];
    }
    if (r->friction_cell > 0.0) /* the mount sticks */
        reading = s->stuck = fmin(fmax(s->stuck, reading - r->friction_cell), reading + r->friction_cell);
    if (r->bend > 0.0) reading -= r->bend * fmax(reading - 0.4, 0.0); /* the cell touches its stop softly */
    return reading + r->bias + r->drift * t / 100.0;
}

/* Everything settled on the first commands. */
static struct state settled(const struct rig *r, double w, double b) {
    struct state s = {0};
    s.held = s.x = s.b = s.play = s.trail = s.inflow = r->travel_max > 0.0 ? fmin(b, r->travel_max) : b;
    s.held = s.led = b;
    s.active = 1.0;
    s.y = s.w = w;
    s.esc = s.w_before = w;
    s.twisted = w * w;
    double T = thrust(r, &s, w, b, 0.0, 0.0);
    s.inflow = b;
    s.drained = s.stuck = T;
    s.slow = s.load = T;
    s.cell = T * (1.0 - r->wash);
    for (int k = 0; k < 4; k++) s.creep[k] = s.cell;
    return s;
}

/* A delayed signal: its last `size` values, the newest at `at`. */
struct past {
    double *values;
    long size, at;
};

static struct past remembered(double delay, double step, double value) {
    struct past p = {0, (long)floor(delay / step + 0.5) + 1, 0};
    p.values = malloc((size_t)p.size * sizeof(double));
    for (long k = 0; k < p.size; k++) p.values[k] = value;
    return p;
}

/* Stores the newest value, returns the oldest. */
static double passed(struct past *p, double value) {
    p->values[p->at] = value;
    p->at = (p->at + 1) % p->size;
    return p->values[p->at];
}

/* A record of n rows, `sub` steps apart; the outputs of a row are those before its command acted. `angle`: that of the mark at
 * the start, revolutions; `jitter[m]`: delay of the m-th of at most `pulses` pulses, s. `shown`: speed as the 4 us timer
 * measures it, held from pulse to pulse, rpm. `turn`: revolutions since the start. */
void run(const struct rig *r, long n, long sub, const double *w_ref, const double *b_ref, double angle, long pulses,
         const double *jitter, double *omega, double *beta, double *load, double *shown, double *turn) {
    struct state s = settled(r, w_ref[0], b_ref[0]);
    double last = s.play, pulse = 0.0, display = floor(r->full * s.w + 0.5), turns = r->full / 60.0;
    struct past readings = remembered(r->reading_delay, r->step, 0.0), displays = remembered(r->speed_late, r->step, display);
    long m = 0;
    for (long k = -(long)(PREROLL * r->slow / r->step + 0.5); k < n * sub; k++) {
        double t = k > 0 ? k * r->step : 0.0, warm = 1.0 + r->warm * (1.0 - exp(-t / 40.0));
        long at = k < 0 ? 0 : k;
        if (k <= 0) s.heat = 0.0; /* warming starts anew with each record */
        double volt = 1.0 - r->discharge * t / 100.0;
        double b = pitch(r, &s, b_ref, at, sub, warm);
        double w = rotor(r, &s, w_ref, at, sub, b, volt);
        double reading = cell(r, &s, thrust(r, &s, w, b, (b - last) / r->step, t), t);
        last = b;
        double step = turns * w * r->step;
        if (floor(angle + step) > floor(angle) && m < pulses) {
            double came = (k + 1) * r->step - (angle + step - floor(angle + step)) / (turns * w) + jitter[m];
            if (m++ > 0) display = floor(60.0 / (4e-6 * floor((came - pulse) / 4e-6 + 0.5)) + 0.5);
            pulse = came;
        }
        angle += step;
        reading = passed(&readings, reading + r->vibration * w * w * sin(2.0 * M_PI * angle));
        double told = passed(&displays, display);
        if (k + 1 < 0 || (k + 1) % sub || (k + 1) / sub >= n) continue;
        long row = (k + 1) / sub;
        omega[row] = w, beta[row] = b, load[row] = reading, shown[row] = told, turn[row] = angle;
    }
    free(readings.values), free(displays.values);
}
