"""The compiled kernel: single cars, batches and long records all run through `steps.march`.

A step of length h is exact in the linear part (matrix exponential, inputs linear over the step, currents
held). Dry friction is set-valued and projected (Moreau, time stepping at velocity level: Acary and Brogliato,
Springer 2008): the friction force stops the sliding if possible within its bound, and otherwise equals the
bound. Smooth laws enter as a force that is linear over the step with an implicit end value (second order).

Cars are *lanes*, eight to a group. There are three ways through a step: in closed form and without branches
(at most one constant friction and one stop: the car), law by law in the lanes with contact, or law by law in
all lanes. The way is a property of the network, and no lane depends on its neighbours: a car in a batch
equals the single car bit by bit.

Several coupled laws are solved by Gauss-Seidel sweeps of secant steps, and by a safeguarded Newton iteration
if the sweeps do not converge. A step that is not solved to `newton.GOOD` has no result: its index and law are
stored, and the state of the lane becomes NaN.

Order of reading:

- `layout`: place of each number, by name; `lanes`: arithmetic on eight numbers at once;
- `linear`: linear part of a step; `contact`: its end in closed form; `law_forces`, `newton`, `solve`: its end law
  by law;
- `steps`: steps, records, outputs; `cars`: a control step of many cars with drive, road, limits, reward and
  observation;
- `compiled`: the compiled functions with the registered laws.

The functions are plain Python until `compiled.kernel` binds them: the functions name one another and are
compiled together. Importing this package costs nothing; `layout` and the modules that use only `layout` do
not need the compiler.
"""
